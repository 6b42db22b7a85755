"""Estimator: answers every measurement with the state, and with the state that the next command will meet."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from hybrid_sysid_ros.configuration import estimator_tuning
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.estimation import Estimate, ExtendedKalmanFilter
from hybrid_sysid_ros.nodes.base import OK, WARN, RigNode, run
from hybrid_sysid_ros.nodes.messages import SECOND, entry, fill, joint_state, nanoseconds
from hybrid_sysid_ros.nodes.model import model_of
from hybrid_sysid_ros.nodes.timing import Timing

RESTART = SECOND  # a stamp so far before the last one is a new experiment
SHOW_PERIOD = SECOND // 20  # ns, between two covariances
BAND = 1.96  # standard deviations about the mean: 95 %


class EstimatorNode(RigNode):
    """joint_states in; state_estimate out with the stamp of the measurement.

    state_estimate has the joint at that stamp and, as NAME_ahead, the joint when the command that answers will act:
    position, velocity, and as effort the input disturbance. It is advertised once there is a measurement to expect,
    so that who sees it knows that measurements come this far.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("estimator", **options)
        self.equation = model_of(self.rig, self.settings["model"]).equation
        joint = self.rig.joint
        self.message = joint_state([joint, f"{joint}_ahead"])
        self.covariance_message = _labelled(self.equation.states)
        self.estimates: Publisher | None = None
        self.covariances = self.open("state_covariance")
        self.begin()
        for k in range(1, 4):  # compiles, and has seen it all once before it matters
            self.on_measurement(fill(joint_state([joint]), k * SECOND // 100, position=(0.0,), effort=(0.0,)))
        self.begin()
        measurements = self.listen("joint_states", self.on_measurement)
        self.when(lambda: measurements.get_publisher_count() > 0, self.advertise)

    def begin(self) -> None:
        """Begin anew, nothing estimated and nothing counted."""
        settings = self.settings
        self.filter = ExtendedKalmanFilter(
            self.equation,
            estimator_tuning(settings, self.rig),
            period=1.0 / settings["rate"],
            latency=settings["latency"],
        )
        self.stamp = self.shown = 0
        self.malformed = self.unusable = self.repeated = self.restarts = 0
        self.execution = Timing()
        self.innovations = 0
        self.innovation_sum = 0.0
        self.troubles: tuple[int, ...] = ()

    def advertise(self) -> None:
        """Open the topic of the estimates."""
        self.estimates = self.open("state_estimate")

    def on_measurement(self, message: JointState) -> None:
        """Answer a measurement."""
        began = perf_counter()
        stamp = nanoseconds(message.header.stamp)
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
        joint = self.rig.joint
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

    def fill(self, estimate: Estimate) -> None:
        """Write an estimate into the message."""
        disturbance = float(estimate.disturbance[0])
        fill(
            self.message,
            self.stamp,
            position=(estimate.state[0], estimate.ahead[0]),
            velocity=(estimate.state[1], estimate.ahead[1]),
            effort=(disturbance, disturbance),
        )

    def publish(self) -> None:
        """Publish the newest estimate."""
        if self.estimates is not None:
            self.estimates.publish(self.message)

    def afterwards(self, estimate: Estimate) -> None:
        """What need not be done before the answer."""
        if math.isfinite(estimate.normalised_innovation):
            self.innovations += 1
            self.innovation_sum += estimate.normalised_innovation
        if self.estimates is None or self.stamp - self.shown < SHOW_PERIOD:
            return
        self.shown = self.stamp
        if self.covariances.get_subscription_count():
            self.covariance_message.data = estimate.covariance.ravel().tolist()
            self.covariances.publish(self.covariance_message)

    def health(self) -> tuple[bytes, str, Mapping[str, object]]:
        counters = self.filter.counters
        count, self.innovations = self.innovations, 0
        mean, self.innovation_sum = self.innovation_sum / max(count, 1), 0.0
        # The sum of n normalised squares is chi-square distributed with n degrees of freedom, nearly normal here.
        half_width = BAND * math.sqrt(2.0 / max(count, 1))
        values = {
            "updates": counters.updates,
            "late_measurements": counters.late,
            "missing_measurements": counters.missing,
            "invalid_entries": counters.invalid,
            "gated_outliers": counters.gated,
            "resets": counters.resets,
            "malformed_messages": self.malformed,
            "unusable_measurements": self.unusable,
            "repeated_measurements": self.repeated,
            "restarts": self.restarts,
            "innovation_mean_square": mean if count else math.nan,
            "innovation_band_low": max(1.0 - half_width, 0.0),
            "innovation_band_high": 1.0 + half_width,
            **self.execution.report("execution"),
        }
        troubles = (counters.late, counters.missing, counters.invalid, counters.gated, self.malformed, self.unusable)
        before, self.troubles = self.troubles, troubles
        if before and troubles != before:
            return WARN, "late, missing, invalid or unbelievable measurements", values
        return OK, "running" if self.stamp else "waiting for measurements", values


def _labelled(states: Any) -> Float64MultiArray:
    """A covariance message, whose rows and columns are named by their label."""
    names = [*(f"{state.name} [{state.unit}]" for state in states), "disturbance", "hum", "hum_quadrature"]
    size = len(names)
    rows = MultiArrayDimension(label=f"covariance of {', '.join(names)}", size=size, stride=size * size)
    columns = MultiArrayDimension(label="the same", size=size, stride=size)
    return Float64MultiArray(layout=MultiArrayLayout(dim=[rows, columns], data_offset=0), data=[0.0] * (size * size))


def main() -> int:
    """Run the node."""
    return run(EstimatorNode)


if __name__ == "__main__":
    sys.exit(main())
