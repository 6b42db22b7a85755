"""Estimator: answers every measurement with the state, and with the state that the next command will meet."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.estimation import METHODS, Estimate
from hybrid_sysid_ros.estimation.consistency import band
from hybrid_sysid_ros.nodes.base import RigNode, run
from hybrid_sysid_ros.nodes.border import Order
from hybrid_sysid_ros.nodes.cdr import JointWriter
from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, WARN, Task
from hybrid_sysid_ros.nodes.layout import Layout, Slots
from hybrid_sysid_ros.nodes.messages import SECOND, Joints
from hybrid_sysid_ros.nodes.model import model_of
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.runtime.configuration import CAMERA, estimator_tuning
from hybrid_sysid_ros.support.errors import UserError

SHOW_PERIOD = SECOND // 20  # ns, between two covariances
SOON = 0.6  # periods, less than which lie between measurements that are more frequent than expected
SLACK = 0.05  # of its range, by which an input may be beyond its limits to be believed
WINDOW = 10.0  # s of innovations whose mean square is told


class EstimatorNode(RigNode):
    """joint_states in; state_estimate out with the stamp of the measurement.

    state_estimate has each joint at that stamp and, as NAME_ahead, when the command that answers will act: position,
    velocity, and as effort the disturbance of its input. Other states, such as link states, deflections, hidden units
    and lags, have entries of their own names and NAME_ahead, their values as position; so have outputs that are no
    motion of a joint, and the followed parameters: they travel with the estimate that they belong to, and a controller
    that adapts answers the same in every run in lockstep. state_estimate is advertised once there is a measurement to
    expect, so that who sees it knows that measurements come this far. A joint_states of NAME_camera alone is of a
    second sensor of the first output: it corrects the estimate at its own stamp and is not answered.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("estimator", **options)
        self.system = system = model_of(self).system
        layout = Layout(self.rig, system)
        limits = [(item.low, item.high, SLACK * (item.high - item.low)) for item in self.rig.actuators]
        bounds = [(low - slack, high + slack) for low, high, slack in limits]
        self.measured = Slots([*layout.outputs, *layout.inputs], bounds=bounds)
        self.given = np.empty(len(self.measured))
        self.outputs, self.applied = np.split(self.given, [len(layout.outputs)])
        self.names = [item.name for item in system.outputs]
        self.camera = Slots([layout.outputs[0].ending(f"_{CAMERA}")])
        self.further = layout.further
        self.noisy = [sensor.noisy for sensor in self.rig.sensors]
        self.estimates: Publisher | None = None
        self.covariances = self.open("state_covariance")
        self.begin()
        followed = tuple(self.filter.tuning.followed)
        self.writer = JointWriter(Slots(layout.estimate(followed)), self.signature)
        self.covariance_message = _labelled(self.filter.labels)
        self.entry = self.border("joint_states")
        self.warm_up()
        self.begin()
        measurements = self.listen(self.entry, "joint_states", self.on_measurement)
        self.when(lambda: measurements.publishers() > 0, self.advertise)

    def warm_up(self) -> None:
        """Take measurements that nobody made: this compiles, and has seen it all once before it matters."""
        for k in range(1, 4):
            self.take([0.0] * len(self.given), round(k * SECOND / self.settings["rate"]), Order.NEW, perf_counter())

    def begin(self) -> None:
        """Begin anew, nothing estimated and nothing counted."""
        settings = self.settings
        self.filter = METHODS[settings["method"]](
            self.system,
            estimator_tuning(settings, self.rig, self.system),
            period=1.0 / settings["rate"],
            latency=settings["latency"],
        )
        self.stamp = self.shown = self.usable = 0
        self.unusable = self.repeated = self.restarts = self.too_soon = self.seen = self.blind = 0
        self.still = [Still(after=round(settings["frozen_after"] * settings["rate"])) for _ in self.outputs]
        self.execution = Timing()
        self.innovations: deque[float] = deque(maxlen=round(WINDOW * settings["rate"]))
        self.parameters: Mapping[str, float] = {}

    def advertise(self) -> None:
        """Open the topic of the estimates."""
        self.estimates = self.open("state_estimate")

    def on_measurement(self, joints: Joints) -> None:
        """Answer a measurement."""
        began = perf_counter()
        if joints.names == self.camera.names:
            frame = self.entry.read(joints, self.camera)
            if frame is not None and self.entry.is_near(joints.stamp):
                self.on_camera(joints.stamp, frame[0])
            return
        given = self.entry.read(joints, self.measured)
        if given is not None and (order := self.entry.admit(joints)) is not None:
            self.take(given, joints.stamp, order, began)

    def take(self, given: list[float], stamp: int, order: Order, began: float) -> None:
        """Answer what a measurement gave, outputs and inputs; stamp [ns], began: when it came [s]."""
        if order is Order.AGAIN:
            self.repeated += 1
            self.publish()
            return
        if order is Order.RESTART:
            self.filter.reset()
            self.stamp = self.shown = self.usable = 0
            self.restarts += 1
        if not self.stamp:
            self.zero = stamp
        elif 0 < stamp - self.stamp < SOON * SECOND / self.settings["rate"]:
            self.too_soon += 1
        for k, still in enumerate(self.still):
            if self.noisy[k] and still.sees(given[k]):
                given[k] = math.nan
        self.given[:] = given
        if any(map(math.isfinite, given[: len(self.outputs)])):
            self.usable = max(stamp, self.usable)
        try:
            estimate = self.filter.update((stamp - self.zero) / SECOND, self.outputs, self.applied)
        except UserError as error:  # nothing to hold on to yet
            self.unusable += 1
            self.get_logger().warning(str(error), once=True)
            return
        if order is Order.LATE:
            return  # the answer to a newer one is out
        self.stamp = stamp
        self.packed = self.pack(estimate)
        taken = perf_counter() - began
        self.publish()
        self.execution.add(taken)
        self.afterwards(estimate)

    def on_camera(self, stamp: int, reading: float) -> None:
        """Use a measurement of the second sensor, in its place by its stamp."""
        try:
            self.filter.correct((stamp - self.zero) / SECOND if self.stamp else 0.0, reading, CAMERA)
            self.seen += 1
        except UserError as error:  # no such sensor in the parameters, or nothing to correct yet
            self.unusable += 1
            self.get_logger().warning(str(error), once=True)

    def pack(self, estimate: Estimate) -> bytes:
        """The message of an estimate."""
        state, ahead, disturbance = estimate.state.tolist(), estimate.ahead.tolist(), estimate.disturbance.tolist()
        further: list[float] = []
        if self.further:
            outputs = output_of(self.system, estimate.state, self.applied + estimate.disturbance)
            further = outputs[self.further].tolist()
        parameters = estimate.parameters.tolist()
        numbers = [*state, *further, *disturbance, *ahead, *disturbance, *parameters]
        if self.stamp - self.usable > self.settings["sensor_timeout"] * SECOND:  # a guess: nobody should act on it
            self.blind += 1
            numbers = [math.nan] * len(numbers)
        return self.writer.pack(self.stamp, numbers)

    def publish(self) -> None:
        """Publish the newest estimate."""
        if self.estimates is not None:
            self.estimates.publish(self.packed)

    def afterwards(self, estimate: Estimate) -> None:
        """What need not be done before the answer."""
        if math.isfinite(estimate.normalised_innovation):
            self.innovations.append(estimate.normalised_innovation)
        self.parameters = dict(zip(self.filter.tuning.followed, estimate.parameters, strict=True))
        if self.estimates is None or self.stamp - self.shown < SHOW_PERIOD:
            return
        self.shown = self.stamp
        if self.covariances.get_subscription_count():
            self.covariance_message.data = estimate.covariance.ravel().tolist()
            self.covariances.publish(self.covariance_message)

    def health(self) -> Sequence[Task]:
        counters, entry = self.filter.counters, self.entry
        loop = {
            "measurements missing": counters.missing,
            "measurements too late": counters.late,
            "measurements sooner than the parameter rate says": self.too_soon,
            "times that time began anew": self.restarts,
            "measurements before the first one of use": self.unusable,
            **{f"measurements {reason}": count for reason, count in self.dropped("joint_states").items()},
        }
        values = {
            "updates": counters.updates,
            "delayed_measurements": counters.delayed,
            "late_measurements": counters.late,
            "missing_measurements": counters.missing,
            "dropped_measurements": sum(entry.dropped.values()),
            "unusable_measurements": self.unusable,
            "repeated_measurements": self.repeated,
            "restarts": self.restarts,
            **self.execution.report("execution"),
        }
        judged = self.silent(self.judged("loop", loop, counters.updates, **values), "joint_states")
        if not self.stamp and judged.level == OK:
            judged = replace(judged, message="waiting for measurements")
        return [judged, self.sensor(), self.believed()]

    def sensor(self) -> Task:
        """What is to be said of the readings."""
        counters, frozen = self.filter.counters, [still.seen for still in self.still]
        values = {
            "invalid_entries": counters.invalid,
            "gated_outliers": counters.gated,
            "resets": counters.resets,
            "camera_measurements": self.seen,
            "blind_estimates": self.blind,
            **{f"frozen_{name}": count for name, count in zip(self.names, frozen, strict=True)},
        }
        troubles = {
            "readings that are no number": counters.invalid - sum(frozen),
            "readings that the model does not believe": counters.gated,
            "estimates without a reading": self.blind,
            **{f"times the same reading of {name}": count for name, count in zip(self.names, frozen, strict=True)},
        }
        return self.judged("sensor", troubles, counters.updates, **values)

    def believed(self) -> Task:
        """What is to be said of the model: whether its innovations are as large as it says."""
        count = len(self.innovations)
        low, high = band(max(count, 1), len(self.outputs))
        mean = math.fsum(self.innovations) / count if count else math.nan
        values = {
            "innovation_mean_square": mean,
            "innovation_band_low": low,
            "innovation_band_high": high,
            **{f"parameter_{name}": value for name, value in self.parameters.items()},
        }
        worse = mean / high if count else 0.0
        level = ERROR if worse > self.settings["innovation_error"] else OK
        if level == OK and worse > self.settings["innovation_warn"]:
            level = WARN
        message = "running" if level == OK else f"innovations {worse:.1f} times as large as the model says"
        return Task(name="model", level=level, message=message, values=values)


class Still:
    """A sensor with noise that shows the same number for too long."""

    def __init__(self, *, after: int) -> None:
        self.seen = 0
        """Readings that were no news."""
        self._after, self._count, self._last = after, 0, math.nan

    def sees(self, reading: float) -> bool:
        """Whether a reading is no news."""
        self._count = self._count + 1 if reading == self._last else 0
        self._last = reading
        found = 0 < self._after <= self._count
        self.seen += found
        return found


def _labelled(names: Sequence[str]) -> Float64MultiArray:
    """A covariance message (size, size), whose rows and columns are named by their label."""
    size = len(names)
    rows = MultiArrayDimension(label=f"covariance of {', '.join(names)}", size=size, stride=size * size)
    columns = MultiArrayDimension(label="the same", size=size, stride=size)
    return Float64MultiArray(layout=MultiArrayLayout(dim=[rows, columns], data_offset=0), data=[0.0] * (size * size))


main = partial(run, EstimatorNode)

if __name__ == "__main__":
    sys.exit(main())
