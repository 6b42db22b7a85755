"""Estimator: answers every measurement with the present state, and the state at which the next command will act."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

from rclpy.publisher import Publisher
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from hybrid_sysid_ros.estimation import StateEstimate
from hybrid_sysid_ros.estimation.consistency import band
from hybrid_sysid_ros.estimation.reversed_input import NONE
from hybrid_sysid_ros.estimation.sensor_monitoring import STAYS
from hybrid_sysid_ros.nodes.adapters import EstimatorAdapter, Measured, model_of
from hybrid_sysid_ros.nodes.base import ModelSource, RigNode
from hybrid_sysid_ros.nodes.diagnostics import ERROR, OK, WARN, Task
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates
from hybrid_sysid_ros.nodes.process import run
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.nodes.validation import StampOrder
from hybrid_sysid_ros.runtime.configuration import CAMERA
from hybrid_sysid_ros.support.errors import UserError

SHOW_PERIOD = SECOND // 20  # ns, between two covariances
SOON = 0.6  # periods, below which measurements are more frequent than expected
REPEATED = 1.0  # s of measurements that an adapter uses before it replaces another one
DIAGNOSTIC = {"innovation_warn", "innovation_error", "warn_share", "error_share", "stale_seconds"}
"""Parameters that change the diagnostics alone."""


class EstimatorNode(RigNode):
    """joint_states in; state_estimate out with the stamp of the measurement.

    state_estimate holds each joint at that stamp and, as NAME_ahead, at the time when the command that answers will
    act: its position, its velocity, and the disturbance of its input as effort. Other states (link states, deflections,
    hidden units, lags), outputs that are no motion of a joint, and followed parameters have entries of their own names,
    with their values as position. The node advertises state_estimate once a publisher of measurements is there.
    Inputs that a driver does not report are those of the newest command, to which the node then listens.
    camera/joint_states holds NAME_camera, a second sensor of the first output. It corrects the estimate at its own
    stamp and is not answered, unless a measurement waits for a first reading to begin with.
    """

    NAME = "estimator"
    PUBLISHES = ("state_estimate", "state_covariance")
    SUBSCRIBES = ("joint_states", "camera/joint_states", "joint_command")

    def configure(self) -> None:
        self.use(self.adapter_of(self.settings))
        self.names = [item.name for item in self.rig.system.outputs]

    def adapter_of(self, settings: Mapping[str, Any]) -> tuple[EstimatorAdapter, ModelSource]:
        """The estimator of the parameters, and the folder of its model."""
        model, source = model_of(self.rig, settings)
        return EstimatorAdapter(self.rig, model, settings, self.signature), source

    def use(self, made: tuple[EstimatorAdapter, ModelSource]) -> None:
        """Estimate with an adapter from now on."""
        self.adapter, source = made
        self.sources = {"model": source}
        self.covariance_message = _labelled(self.adapter.estimator.filter.labels)

    def forget(self) -> None:
        """Begin a new experiment."""
        self.adapter.begin()
        self.stamp = self.shown = self.usable = self.zero = 0
        self.waiting: tuple[list[float], int] | None = None
        """A measurement that waits for a first reading."""
        self.recent: deque[Measured] = deque(maxlen=round(REPEATED * self.settings["rate"]))

    def prepare(self, settings: Mapping[str, Any], names: frozenset[str]) -> Callable[[], object]:
        if names <= DIAGNOSTIC:
            return super().prepare(settings, names)
        made = self.adapter_of(settings)
        seen = list(self.recent) if self.active else []
        made[0].see(seen)

        def take_over() -> None:
            if self.active:
                made[0].see([item for item in self.recent if not seen or item[0] > seen[-1][0]])
            self.use(made)

        return take_over

    def activate(self) -> None:
        self.forget()
        self.unusable = self.repeated = self.restarts = self.too_soon = self.seen = self.blind = 0
        self.execution = Timing()
        self.estimates: Publisher | None = None
        self.covariances = self.open("state_covariance")
        self.entry, self.listening = self.validator("joint_states"), False
        if self.adapter.estimator.tuning.channels:
            self.frames = self.validator("camera/joint_states")
            self.listen(self.frames, "camera/joint_states", self.on_camera)
        measurements = self.listen(self.entry, "joint_states", self.on_measurement)
        self.when(lambda: measurements.publishers() > 0, self.advertise)

    def own_services(self) -> Mapping[str, Callable[[], object]]:
        return {"reset": self.forget}

    def advertise(self) -> None:
        """Open the topic of the estimates."""
        self.estimates = self.open("state_estimate")

    def on_measurement(self, joints: JointStates) -> None:
        """Answer a measurement."""
        began = perf_counter()
        given = self.entry.read(joints, self.adapter.measured, optional=len(self.adapter.applied))
        if given is not None and (order := self.entry.admit(joints)) is not None:
            self.answer(given, joints.stamp, order, began)
            if not self.listening and any(map(math.isnan, self.adapter.applied.tolist())):
                self.listening = True
                self.soon(self.listen_to_commands)

    def listen_to_commands(self) -> None:
        """Let commands stand for the inputs that a driver does not report."""
        commands = self.validator("joint_command")

        def on_command(joints: JointStates) -> None:
            inputs = commands.read(joints, self.adapter.inputs)
            if inputs is not None and commands.accepts_source(joints.source) and all(map(math.isfinite, inputs)):
                commands.select_source(joints.source)
                self.adapter.commanded[:] = inputs

        self.listen(commands, "joint_command", on_command)

    def answer(self, given: list[float], stamp: int, order: StampOrder, began: float) -> None:
        """Answer outputs and inputs of a measurement; stamp [ns], began: time of its arrival [s]."""
        if order is StampOrder.DUPLICATE:
            self.repeated += 1
            self.publish()
            return
        if order is StampOrder.RESTART:
            self.adapter.estimator.filter.reset()
            self.stamp = self.shown = self.usable = self.zero = 0
            self.restarts += 1
        self.zero = self.zero or stamp
        if self.stamp and 0 < stamp - self.stamp < SOON * SECOND / self.settings["rate"]:
            self.too_soon += 1
        self.adapter.given[:] = given
        try:
            estimate = self.adapter.update((stamp - self.zero) / SECOND)
        except UserError as error:  # there is no reading yet
            self.unusable += 1
            self.waiting = given, stamp
            self.get_logger().warning(str(error), once=True)
            return
        finally:  # without the readings of frozen sensors
            shown = [*self.adapter.estimator.shown.tolist(), *self.adapter.applied.tolist()]
            self.recent.append(((stamp - self.zero) / SECOND, shown))
        self.waiting = None
        if any(map(math.isfinite, self.adapter.estimator.outputs.tolist())):
            self.usable = max(stamp, self.usable)
        if order is StampOrder.LATE:
            return  # the answer to a newer one is out
        self.stamp = stamp
        blind = stamp - self.usable > self.settings["sensor_timeout"] * SECOND
        self.blind += blind
        self.packed = self.adapter.pack(estimate, stamp, blind=blind)
        taken = perf_counter() - began
        self.publish()
        self.execution.add(taken)
        self.afterwards(estimate)

    def on_camera(self, joints: JointStates) -> None:
        """Use a frame of a camera at the time of its stamp."""
        began, found, stamp = perf_counter(), self.frames.read(joints, self.adapter.camera), joints.stamp
        if found is None or not self.frames.is_near(stamp) or not self.frames.accepts_source(joints.source):
            return
        self.frames.select_source(joints.source)
        self.zero = self.zero or stamp
        try:
            self.adapter.estimator.filter.correct((stamp - self.zero) / SECOND, found[0], CAMERA)
        except UserError as error:  # nothing to correct yet
            self.unusable += 1
            self.get_logger().warning(str(error), once=True)
            return
        self.seen += 1
        if math.isfinite(found[0]):
            self.usable = max(stamp, self.usable)
        if self.waiting is not None:
            self.answer(*self.waiting, StampOrder.NEW, began)

    def publish(self) -> None:
        """Publish the newest estimate."""
        if self.estimates is not None:
            self.estimates.publish(self.packed)

    def afterwards(self, estimate: StateEstimate) -> None:
        """Do work that may follow the answer."""
        self.adapter.note(estimate)
        if self.estimates is None or self.stamp - self.shown < SHOW_PERIOD:
            return
        self.shown = self.stamp
        if self.covariances.get_subscription_count():
            self.covariance_message.data = estimate.covariance.ravel().tolist()
            self.covariances.publish(self.covariance_message)

    def health(self) -> Sequence[Task]:
        counters, entry = self.adapter.estimator.filter.counters, self.entry
        dropped = self.dropped("camera/joint_states") if "camera/joint_states" in self.validators else {}
        loop = {
            "measurements missing": counters.missing,
            "measurements too late": counters.late,
            "measurements sooner than the parameter rate says": self.too_soon,
            "times that time began anew": self.restarts,
            "measurements before the first one of use": self.unusable,
            **{f"measurements {reason}": count for reason, count in self.dropped("joint_states").items()},
            **{f"frames {reason}": count for reason, count in dropped.items()},
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
        return [judged, self.sensor(), self.model()]

    def sensor(self) -> Task:
        """The task of the sensors: readings that are missing, frozen or implausible."""
        estimator = self.adapter.estimator
        counters, frozen = estimator.filter.counters, [detector.count for detector in estimator.frozen]
        left_out = dict(zip(self.names, estimator.monitor.counts, strict=True))
        values = {
            "invalid_entries": counters.invalid,
            "unknown_inputs": counters.unknown_inputs,
            "gated_outliers": counters.gated,
            "resets": counters.resets,
            "camera_measurements": self.seen,
            "blind_estimates": self.blind,
            **{f"frozen_{name}": count for name, count in zip(self.names, frozen, strict=True)},
            **{f"left_out_{name}": count for name, count in left_out.items()},
        }
        troubles = {
            "readings that are no number": counters.invalid - sum(frozen),
            "readings that the model does not believe": counters.gated,
            "estimates without a reading": self.blind,
            **{f"times the same reading of {name}": count for name, count in zip(self.names, frozen, strict=True)},
        }
        task = self.judged("sensor", troubles, counters.updates, **values)
        out = [name for name, is_out in zip(self.names, estimator.monitor.left_out, strict=True) if is_out]
        which = estimator.reversal.reversed
        found = [f"{', '.join(out)} contradicts the model and is left out"] if out else []
        found = [f"input {self.rig.system.inputs[which].name} acts reversed", *found] if which != NONE else found
        if found:
            words = "; ".join([*found, task.message]).removesuffix("; running")
            task = replace(task, level=max(task.level, WARN), message=words)
        return task

    def model(self) -> Task:
        """The task of the model: whether innovations are as large as it predicts."""
        innovations, parameters = list(self.adapter.innovations), self.adapter.parameters
        count = len(innovations)
        low, high = band(max(count, 1), len(self.names))
        mean = math.fsum(innovations) / count if count else math.nan
        values: dict[str, object] = {
            "innovation_mean_square": mean,
            "innovation_band_low": low,
            "innovation_band_high": high,
            "doubt": self.adapter.estimator.doubt,
            **{f"parameter_{name}": value for name, value in parameters.items()},
        }
        reports = [check.report() for check in self.adapter.checks]
        for _, further in reports:
            values.update(further)
        worse = mean / high if count else 0.0
        level = ERROR if worse > self.settings["innovation_error"] else OK
        if level == OK and worse > self.settings["innovation_warn"]:
            level = WARN
        message = "running" if level == OK else f"innovations {worse:.1f} times as large as the model says"
        if (doubt := self.doubted() or "; ".join(words for words, _ in reports if words)) and level == OK:
            level, message = WARN, doubt
        return Task(name="model", level=level, message=message, values=values)

    def doubted(self) -> str:
        """The evidence against the present estimate, in words; "" where there is none."""
        estimator = self.adapter.estimator
        sensors = zip(self.names, estimator.monitor.sensors, strict=True)
        if outside := [name for name, sensor in sensors if sensor.beyond > STAYS]:
            return f"{', '.join(outside)} shows a state outside of the rig's travel or validity"
        names = [name for name, r in zip(self.names, estimator.monitor.evidence, strict=True) if r >= 1.0]
        silent = [sensor.silent > estimator.monitor.record.timeout for sensor in estimator.monitor.sensors]
        if nothing := [name for name, is_silent in zip(self.names, silent, strict=True) if is_silent and name in names]:
            return f"{', '.join(nothing)} shows nothing, and the others do not tell the state"
        if names:
            return f"innovations of {', '.join(names)} are not as large as the model says"
        return "the estimated input disturbance is at its limit" if estimator.watch.diverged else ""


def _labelled(names: Sequence[str]) -> Float64MultiArray:
    """A covariance message (size, size) with labels of rows and columns."""
    size = len(names)
    rows = MultiArrayDimension(label=f"covariance of {', '.join(names)}", size=size, stride=size * size)
    columns = MultiArrayDimension(label="the same", size=size, stride=size)
    return Float64MultiArray(layout=MultiArrayLayout(dim=[rows, columns], data_offset=0), data=[0.0] * (size * size))


main = partial(run, EstimatorNode)

if __name__ == "__main__":
    sys.exit(main())
