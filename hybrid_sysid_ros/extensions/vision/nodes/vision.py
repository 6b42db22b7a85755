"""Vision: reads a joint's position out of pictures."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Sequence
from functools import partial
from time import perf_counter

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import CompressedImage

from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import STANDS, AngleReader, AngleReading
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.light_across import LightMeter
from hybrid_sysid_ros.extensions.vision.reading.unused_pictures import FROZEN
from hybrid_sysid_ros.nodes.base import ModelSource, RigNode
from hybrid_sysid_ros.nodes.cdr import JointWriter
from hybrid_sysid_ros.nodes.diagnostics import OK, Task
from hybrid_sysid_ros.nodes.messages import nanoseconds
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.runtime.configuration import CAMERA, shipped
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

DEVIATION = "deviation"
"""Ending of the entry that has the standard deviation of a camera's position."""
LOOKS, APART = 8, 10
"""Pictures, and how far apart, by which a moved camera is known; somebody who comes by is in a few of them only."""


class VisionNode(RigNode):
    """camera/image_raw/compressed in; camera/joint_states out: of the joint that the layers show, as NAME_camera, its
    position, and as NAME_camera_deviation the standard deviation of it, whose square is the covariance; stamped when
    the rows that tell of it were exposed. A picture without the joint, of a camera that hangs, or that was moved since
    the layers were learned, is answered too, with no number. They are advertised once there are pictures to expect, so
    that who sees that knows that a camera is there.
    """

    NAME = "vision"
    PUBLISHES = ("camera/joint_states",)
    SUBSCRIBES = ("camera/image_raw/compressed",)

    def configure(self) -> None:
        jpeg.check_available()
        folder = self.settings["layers"] or shipped(self.rig.name, "layers")
        layers = PictureLayers.load(folder)
        if layers.geometry.rig != self.rig.name:
            raise UserError(f"{folder}: the layers are of the rig {layers.geometry.rig}, not of {self.rig.name}")
        self.sources = {"loop": ModelSource(folder)}
        self.reader, self.light = AngleReader(layers), LightMeter(layers.background)
        drawn = layers.drawn(layers.geometry.low).astype(np.uint8)
        self.reader.read(jpeg.decoded(jpeg.encoded(drawn, 80)))  # loads the codec, and compiles for what it gives
        entry = f"{layers.geometry.joint}_{CAMERA}"
        slots = Slots([SignalPlace(entry, "position"), SignalPlace(f"{entry}_{DEVIATION}", "position")])
        self.writer = JointWriter(slots, self.signature)

    def activate(self) -> None:
        self.readings: Publisher | None = None
        self.reading = Timing()
        self.frames = self.lost = self.unreadable = self.displaced = self.frozen = 0
        self.same, self.before = 0, b""
        """How often the newest picture has come, and that picture."""
        self.sceneries = deque[Array](maxlen=LOOKS)
        self.moved = False
        self.entry = self.validator("camera/image_raw/compressed")
        images = self.listen(self.entry, "camera/image_raw/compressed", self.on_image)
        self.when(lambda: images.publishers() > 0, self.advertise)

    def advertise(self) -> None:
        """Open the topic of the readings."""
        self.readings = self.open("camera/joint_states")

    def on_image(self, message: CompressedImage) -> None:
        """Answer a picture."""
        began, layers = perf_counter(), self.reader.layers
        self.frames += 1
        data = bytes(message.data)
        self.same, self.before = self.same + 1 if data == self.before else 1, data
        stamp, position, deviation = nanoseconds(message.header.stamp), math.nan, math.nan
        try:
            reading = self.look(jpeg.decoded(data))
        except UserError as error:
            self.unreadable += 1
            self.get_logger().warning(str(error), once=True)
        else:
            if self.moved:
                self.displaced += 1
            elif self.same >= FROZEN:
                self.frozen += 1
            elif reading.found:
                stamp += round(1e9 * layers.row_time(reading.row))
                position = layers.position(reading.angle)
                deviation = abs(layers.geometry.scale) * reading.deviation
            else:
                self.lost += 1
        if self.readings is not None:
            self.readings.publish(self.writer.pack(stamp, [position, deviation]))
        self.entry.select_source(message.header.frame_id)
        self.reading.add(perf_counter() - began)

    def look(self, picture: Picture) -> AngleReading:
        """Read a picture, and see whether the camera was moved. Raises UserError for one of another size."""
        picture = self.light.evened(picture)
        reading = self.reader.read(picture)
        if self.frames % APART == 1 and self.reader.lit:
            self.sceneries.append(self.reader.scenery(picture))
            before, self.moved = self.moved, self.reader.standing(self.sceneries) < STANDS
            if self.moved and not before:
                self.get_logger().error(
                    "what stands in the pictures is not where it was when the layers were learned: the camera was "
                    "moved; put it back, or learn the layers again (hybrid-sysid video --learn)"
                )
        return reading

    def health(self) -> Sequence[Task]:
        troubles = {
            "pictures without the joint": self.lost,
            "pictures by a camera that was moved": self.displaced,
            "pictures that are the same as those before": self.frozen,
            "pictures that can't be read": self.unreadable,
            **{f"pictures {reason}": count for reason, count in self.dropped("camera/image_raw/compressed").items()},
        }
        values = {
            "frames": self.frames,
            "lost_frames": self.lost,
            "displaced_frames": self.displaced,
            "frozen_frames": self.frozen,
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
