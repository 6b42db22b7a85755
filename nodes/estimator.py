"""Estimator: answers every measurement with the state, and with the state that the next command will meet."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from hybrid_sysid_ros.estimation import METHODS, Estimate
from hybrid_sysid_ros.estimation.consistency import Window, band
from hybrid_sysid_ros.nodes.base import OK, WARN, RigNode, run
from hybrid_sysid_ros.nodes.messages import SECOND, entry, fill, joint_state, nanoseconds
from hybrid_sysid_ros.nodes.model import model_of
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.runtime.configuration import CAMERA, estimator_tuning
from hybrid_sysid_ros.support.errors import UserError

RESTART = SECOND  # a stamp so far before the last one is a new experiment
SHOW_PERIOD = SECOND // 20  # ns, between two covariances
WINDOW = 10.0  # s of innovations whose mean square is told


class EstimatorNode(RigNode):
    """joint_states in; state_estimate out with the stamp of the measurement.

    state_estimate has the joint at that stamp and, as NAME_ahead, the joint when the command that answers will act:
    position, velocity, and as effort the input disturbance. Each followed parameter is beside them as NAME_PARAMETER,
    its value as position: they travel with the estimate that they belong to, and a controller that adapts answers the
    same in every run in lockstep. state_estimate is advertised once there is a measurement to expect, so that who sees
    it knows that measurements come this far. A joint_states of NAME_camera alone is of a second sensor: it corrects the
    estimate at its own stamp and is not answered.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("estimator", **options)
        self.system = model_of(self.rig, self.settings["model"]).system
        joint = self.rig.joint
        self.camera = f"{joint}_{CAMERA}"
        self.estimates: Publisher | None = None
        self.covariances = self.open("state_covariance")
        self.begin()
        followed = tuple(self.filter.tuning.followed)
        self.message = joint_state([joint, f"{joint}_ahead", *(f"{joint}_{name}" for name in followed)])
        self.unknown = (math.nan,) * len(followed)  # a parameter has no velocity and no effort
        self.covariance_message = _labelled(self.filter.labels)
        for k in range(1, 4):  # compiles, and has seen it all once before it matters
            self.on_measurement(fill(joint_state([joint]), k * SECOND // 100, position=(0.0,), effort=(0.0,)))
        self.begin()
        measurements = self.listen("joint_states", self.on_measurement)
        self.when(lambda: measurements.get_publisher_count() > 0, self.advertise)

    def begin(self) -> None:
        """Begin anew, nothing estimated and nothing counted."""
        settings = self.settings
        self.filter = METHODS[settings["method"]](
            self.system,
            estimator_tuning(settings, self.rig),
            period=1.0 / settings["rate"],
            latency=settings["latency"],
        )
        self.stamp = self.shown = 0
        self.malformed = self.unusable = self.repeated = self.restarts = self.seen = 0
        self.execution = Timing()
        self.innovations = Window(round(WINDOW * settings["rate"]))
        self.parameters: Mapping[str, float] = {}
        self.troubles: tuple[int, ...] = ()

    def advertise(self) -> None:
        """Open the topic of the estimates."""
        self.estimates = self.open("state_estimate")

    def on_measurement(self, message: JointState) -> None:
        """Answer a measurement."""
        began = perf_counter()
        stamp, joint = nanoseconds(message.header.stamp), self.rig.joint
        if self.camera in message.name and joint not in message.name:
            self.on_camera(message, stamp)
            return
        if self.stamp and stamp == self.stamp:
            self.repeated += 1
            self.publish()
            return
        if stamp < self.stamp - RESTART:
            self.filter.reset()
            self.stamp = self.shown = 0
            self.restarts += 1
        if not self.stamp:
            self.zero = stamp
        position, applied = entry(message.name, message.position, joint), entry(message.name, message.effort, joint)
        self.malformed += joint not in message.name
        try:
            estimate = self.filter.update((stamp - self.zero) / SECOND, np.array([position]), np.array([applied]))
        except UserError as error:  # nothing to hold on to yet
            self.unusable += 1
            self.get_logger().warning(str(error), once=True)
            return
        if stamp < self.stamp:
            return  # the answer to a newer one is out
        self.stamp = stamp
        self.fill(estimate)
        self.execution.add(perf_counter() - began)
        self.publish()
        self.afterwards(estimate)

    def on_camera(self, message: JointState, stamp: int) -> None:
        """Use a measurement of the second sensor, in its place by its stamp."""
        position = entry(message.name, message.position, self.camera)
        try:
            self.filter.correct((stamp - self.zero) / SECOND if self.stamp else 0.0, position, CAMERA)
            self.seen += 1
        except UserError as error:  # no such sensor in the parameters, or nothing to correct yet
            self.unusable += 1
            self.get_logger().warning(str(error), once=True)

    def fill(self, estimate: Estimate) -> None:
        """Write an estimate into the message."""
        disturbance = float(estimate.disturbance[0])
        fill(
            self.message,
            self.stamp,
            position=(estimate.state[0], estimate.ahead[0], *estimate.parameters),
            velocity=(estimate.state[1], estimate.ahead[1], *self.unknown),
            effort=(disturbance, disturbance, *self.unknown),
        )

    def publish(self) -> None:
        """Publish the newest estimate."""
        if self.estimates is not None:
            self.estimates.publish(self.message)

    def afterwards(self, estimate: Estimate) -> None:
        """What need not be done before the answer."""
        self.innovations.add(estimate.normalised_innovation)
        self.parameters = dict(zip(self.filter.tuning.followed, estimate.parameters, strict=True))
        if self.estimates is None or self.stamp - self.shown < SHOW_PERIOD:
            return
        self.shown = self.stamp
        if self.covariances.get_subscription_count():
            self.covariance_message.data = estimate.covariance.ravel().tolist()
            self.covariances.publish(self.covariance_message)

    def health(self) -> tuple[bytes, str, Mapping[str, object]]:
        counters = self.filter.counters
        low, high = band(max(len(self.innovations), 1), len(self.system.outputs))
        values = {
            "updates": counters.updates,
            "delayed_measurements": counters.delayed,
            "late_measurements": counters.late,
            "missing_measurements": counters.missing,
            "invalid_entries": counters.invalid,
            "gated_outliers": counters.gated,
            "resets": counters.resets,
            "malformed_messages": self.malformed,
            "unusable_measurements": self.unusable,
            "repeated_measurements": self.repeated,
            "restarts": self.restarts,
            "camera_measurements": self.seen,
            "innovation_mean_square": self.innovations.mean,
            "innovation_band_low": low,
            "innovation_band_high": high,
            **{f"parameter_{name}": value for name, value in self.parameters.items()},
            **self.execution.report("execution"),
        }
        troubles = (counters.late, counters.missing, counters.invalid, counters.gated, self.malformed, self.unusable)
        before, self.troubles = self.troubles, troubles
        if before and troubles != before:
            return WARN, "late, missing, invalid or unbelievable measurements", values
        return OK, "running" if self.stamp else "waiting for measurements", values


def _labelled(names: Sequence[str]) -> Float64MultiArray:
    """A covariance message, whose rows and columns are named by their label."""
    size = len(names)
    rows = MultiArrayDimension(label=f"covariance of {', '.join(names)}", size=size, stride=size * size)
    columns = MultiArrayDimension(label="the same", size=size, stride=size)
    return Float64MultiArray(layout=MultiArrayLayout(dim=[rows, columns], data_offset=0), data=[0.0] * (size * size))


def main() -> int:
    """Run the node."""
    return run(EstimatorNode)


if __name__ == "__main__":
    sys.exit(main())
