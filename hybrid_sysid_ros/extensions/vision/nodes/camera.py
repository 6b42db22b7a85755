"""Camera: takes pictures of the simulated rig: its true motion in, compressed images out."""

from __future__ import annotations

import sys
from array import array
from collections.abc import Mapping, Sequence
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage

from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.diagnostics import OK, Task
from hybrid_sysid_ros.nodes.messages import SECOND, TrajectoryMessage, set_nanoseconds
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.nodes.timing import Timing

KEPT = 1.0  # s of the motion
JPEG = "jpeg"
OF_CAMERA = ("width", "height", "rate", "exposure", "readout", "noise", "gain", "light", "flicker")


def camera_of(settings: Mapping[str, Any]) -> Camera:
    """What the parameters say. Raises UserError where no camera is like that."""
    return Camera(**{name: settings[name] for name in OF_CAMERA})


class CameraNode(RigNode):
    """motion in; camera/image_raw/compressed out, grey, stamped in the middle of the exposure of the middle row, and
    camera/camera_info (not calibrated) with the same stamp.

    The first picture is of the moment before the first motion, when the rig stood; the others follow by the rate. Each
    is taken once the motion is known to the end of its exposure; in lockstep, too.
    """

    NAME = "camera"
    PUBLISHES = ("camera/image_raw/compressed", "camera/camera_info")
    SUBSCRIBES = ("motion",)

    def configure(self) -> None:
        jpeg.check_available()
        self.camera, scene = camera_of(self.settings), scene_of(self.rig)
        self.joint = scene.joint
        self.imager = Imager(scene, self.camera, seed=self.settings["seed"])
        picture = self.imager.take(0.0, np.array([0.0, 1.0]), np.zeros(2))  # compiles
        jpeg.encoded(picture, self.settings["quality"])  # loads its codec
        self.lead = round(self.imager.lead * SECOND)

    def activate(self) -> None:
        self.taking = Timing()
        self.frames = self.restarts = 0
        self.began = self.known = 0
        self.times, self.angles = np.empty(0, dtype=np.int64), np.empty(0)
        self.entry = self.validator("motion")
        self.listen(self.entry, "motion", self.on_motion)
        self.images = self.open("camera/image_raw/compressed")  # who sees it knows that the motion is heard
        self.infos = self.open("camera/camera_info")

    def on_motion(self, motion: TrajectoryMessage) -> None:
        """Take the pictures whose exposure has ended by now."""
        if self.joint not in motion.names or not motion.lists[0]:
            return
        times, angles = motion.stamp + motion.times, motion.lists[0][list(motion.names).index(self.joint)]
        if not len(times) or not np.isfinite(angles).all():
            return
        if self.began and times[0] < self.known - KEPT * SECOND:  # a new experiment
            self.began, self.restarts = 0, self.restarts + 1
        if not self.began:
            self.began = int(times[0]) - self.lead
            self.number = 0
            self.times = np.array([self.began - self.lead - SECOND, times[0] - 1])
            self.angles = np.array([angles[0], angles[0]])
        new = times > self.times[-1]
        self.times, self.angles = np.append(self.times, times[new]), np.append(self.angles, angles[new])
        self.known = int(self.times[-1])
        while (stamp := self.stamp(self.number)) + self.lead <= self.known:
            self.take(stamp)
            self.number += 1
        past = int(np.searchsorted(self.times, stamp - self.lead)) - 2
        if past > 0:
            self.times, self.angles = self.times[past:], self.angles[past:]

    def stamp(self, number: int) -> int:
        """Of a picture [ns]."""
        return self.began + round(number * SECOND / self.camera.rate)

    def take(self, stamp: int) -> None:
        """Take a picture and publish it."""
        began = perf_counter()
        seconds = (self.times - stamp).astype(np.float64) * 1e-9
        picture = self.imager.take(0.0, seconds, self.angles, onset=(self.began + self.lead - stamp) * 1e-9)
        message = CompressedImage(format=JPEG, data=array("B", jpeg.encoded(picture, self.settings["quality"])))
        info = CameraInfo(width=self.camera.width, height=self.camera.height)
        for header in (message.header, info.header):
            set_nanoseconds(header.stamp, stamp)
            header.frame_id = self.signature
        self.images.publish(message)
        self.infos.publish(info)
        self.frames += 1
        self.taking.add(perf_counter() - began)

    def health(self) -> Sequence[Task]:
        troubles = {
            "times that time began anew": self.restarts,
            **{f"motions {reason}": count for reason, count in self.dropped("motion").items()},
        }
        values = {"frames": self.frames, **self.taking.report("taking")}
        task = self.silent(self.judged("loop", troubles, max(self.frames, 1), **values), "motion")
        waiting = not self.frames and task.level == OK
        return [Task(name="loop", message="waiting for a motion", values=values) if waiting else task]


main = partial(run, CameraNode)

if __name__ == "__main__":
    sys.exit(main())
