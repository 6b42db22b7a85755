"""Vision: reads a joint's position out of pictures."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from functools import partial
from time import perf_counter

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import CompressedImage

from hybrid_sysid_ros.camera import jpeg
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.cdr import JointWriter
from hybrid_sysid_ros.nodes.diagnostics import OK, Task
from hybrid_sysid_ros.nodes.layout import Place, Slots
from hybrid_sysid_ros.nodes.messages import nanoseconds
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.nodes.source import Source
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.runtime.configuration import CAMERA, shipped
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.vision.angle_reader import AngleReader
from hybrid_sysid_ros.vision.layers import Layers

DEVIATION = "deviation"
"""Ending of the entry that has the standard deviation of a camera's position."""


class VisionNode(RigNode):
    """camera/image_raw/compressed in; camera/joint_states out: of the joint that the layers show, as NAME_camera, its
    position, and as NAME_camera_deviation the standard deviation of it, whose square is the covariance; stamped when
    the rows that tell of it were exposed. A picture without the joint is answered too, with no number. They are
    advertised once there are pictures to expect, so that who sees that knows that a camera is there.
    """

    NAME = "vision"
    PUBLISHES = ("camera/joint_states",)
    HEARS = ("camera/image_raw/compressed",)

    def configure(self) -> None:
        jpeg.check_available()
        folder = self.settings["layers"] or shipped(self.rig.name, "layers")
        layers = Layers.load(folder)
        if layers.geometry.rig != self.rig.name:
            raise UserError(f"{folder}: the layers are of the rig {layers.geometry.rig}, not of {self.rig.name}")
        self.sources = {"loop": Source(folder)}
        self.reader = AngleReader(layers)
        drawn = layers.drawn(layers.geometry.low).astype(np.uint8)
        self.reader.read(jpeg.decoded(jpeg.encoded(drawn, 80)))  # loads the codec, and compiles for what it gives
        entry = f"{layers.geometry.joint}_{CAMERA}"
        slots = Slots([Place(entry, "position"), Place(f"{entry}_{DEVIATION}", "position")])
        self.writer = JointWriter(slots, self.signature)

    def activate(self) -> None:
        self.readings: Publisher | None = None
        self.reading = Timing()
        self.frames = self.lost = self.unreadable = 0
        self.entry = self.border("camera/image_raw/compressed")
        images = self.listen(self.entry, "camera/image_raw/compressed", self.on_image)
        self.when(lambda: images.publishers() > 0, self.advertise)

    def advertise(self) -> None:
        """Open the topic of the readings."""
        self.readings = self.open("camera/joint_states")

    def on_image(self, message: CompressedImage) -> None:
        """Answer a picture."""
        began, layers = perf_counter(), self.reader.layers
        self.frames += 1
        stamp, position, deviation = nanoseconds(message.header.stamp), math.nan, math.nan
        try:
            reading = self.reader.read(jpeg.decoded(bytes(message.data)))
        except UserError as error:
            self.unreadable += 1
            self.get_logger().warning(str(error), once=True)
        else:
            if reading.found:
                stamp += round(1e9 * layers.row_time(reading.row))
                position = layers.position(reading.angle)
                deviation = abs(layers.geometry.scale) * reading.deviation
            else:
                self.lost += 1
        if self.readings is not None:
            self.readings.publish(self.writer.pack(stamp, [position, deviation]))
        self.entry.believe(message.header.frame_id)
        self.reading.add(perf_counter() - began)

    def health(self) -> Sequence[Task]:
        troubles = {
            "pictures without the joint": self.lost,
            "pictures that can't be read": self.unreadable,
            **{f"pictures {reason}": count for reason, count in self.dropped("camera/image_raw/compressed").items()},
        }
        values = {
            "frames": self.frames,
            "lost_frames": self.lost,
            "unreadable_frames": self.unreadable,
            **self.reading.report("reading"),
        }
        judged = self.judged("loop", troubles, max(self.frames, 1), **values)
        task = self.silent(judged, "camera/image_raw/compressed")
        waiting = not self.frames and task.level == OK
        return [Task(name="loop", message="waiting for pictures", values=values) if waiting else task]


main = partial(run, VisionNode)

if __name__ == "__main__":
    sys.exit(main())
