"""Adapters: estimators and controllers for the nodes, which are made beside a running loop."""

from __future__ import annotations

import gc
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.control.safety.guard import Guard
from hybrid_sysid_ros.estimation import StateEstimate
from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.nodes.base import ModelSource
from hybrid_sysid_ros.nodes.cdr import JointWriter, TrajectoryWriter
from hybrid_sysid_ros.nodes.diagnostics import Task
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates
from hybrid_sysid_ros.nodes.signal_layout import AHEAD, SignalLayout, SignalPlace, Slots
from hybrid_sysid_ros.nodes.subscriptions import Listener
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import (
    CAMERA,
    estimator_model,
    guard_settings,
    shipped,
)
from hybrid_sysid_ros.runtime.controllers import controller_of, policy_folder
from hybrid_sysid_ros.runtime.estimators import estimator_of, prediction_step
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SLACK = 0.05  # of its range, by which an input may be beyond its limits to be accepted
WINDOW = 10.0  # s of innovations whose mean square is reported
Measured = tuple[float, list[float]]
"""Time [s], and the measured outputs and applied inputs."""
OF_PROBLEM = {
    *("output_weight", "rate_weight", "input_weight", "input_rate", "limits", "input_low", "input_high"),
    *("state_low", "state_high", "soft_linear", "soft_quadratic"),
}
"""Parameters that a network was trained with."""
WARM_UPS = 6  # answers of a controller before it drives
COMPILING = 1.0  # s, above which an answer has compiled something


def model_of(rig: Rig, settings: Mapping[str, Any]) -> tuple[Model, ModelSource]:
    """The model that the parameter names, or the one that comes with the package, and its folder. Raises UserError
    where it cannot be loaded or belongs to another rig.
    """
    folder = settings["model"] or shipped(rig.name, "model")
    source = ModelSource(folder)
    return estimator_model(rig, load(folder, rig=rig.source)), source


class LoopCheck(Protocol):
    """What an extension watches in a running loop."""

    def see(self, estimate: StateEstimate, applied: Array) -> None:
        """Take an estimate, and the inputs (m,) that acted."""

    def report(self) -> tuple[str, Mapping[str, object]]:
        """What is wrong, "" for nothing, and values for the diagnostics."""


def loop_checks(model: Model, settings: Mapping[str, Any]) -> list[LoopCheck]:
    """The checks of all extensions that have one for a model and the estimator's parameters."""
    made = (make(model, settings) for make in extensions.provided("loop_checks").values())
    return [check for check in made if check is not None]


class EstimateSource(Protocol):
    """What makes estimates of measurements in the place of the node estimator."""

    def listen(self, node: Any) -> Listener:
        """Answer measurements, by ``node.on_estimate``, as long as the node, a controller, is active."""

    def tasks(self) -> Sequence[Task]:
        """What it says of itself in the diagnostics."""


class EstimatorAdapter:
    """An estimator with the layouts of its measurements and estimates. It is made beside a loop that uses another one.

    given: outputs and applied inputs of a measurement (p + m,), written by the caller before update().
    """

    def __init__(self, rig: Rig, model: Model, settings: Mapping[str, Any], signature: str) -> None:
        """Compile. Raises UserError where parameters and model don't fit each other."""
        system = model.system
        layout = SignalLayout(rig, system)
        limits = [(item.low, item.high, SLACK * (item.high - item.low)) for item in rig.actuators]
        bounds = [(low - slack, high + slack) for low, high, slack in limits]
        self.measured = Slots([*layout.outputs, *layout.inputs], bounds=bounds)
        self.camera = Slots([layout.outputs[0].ending(f"_{CAMERA}")])
        self.given = np.zeros(len(self.measured))
        self.outputs, self.applied = np.split(self.given, [len(layout.outputs)])
        self.inputs, self.commanded = Slots(layout.inputs, bounds=bounds), np.full(len(bounds), math.nan)
        """Of commands, the newest one of which (m,) acts where a measurement does not say what does; NaN: unknown."""
        self.estimator = estimator_of(rig, system, settings, step=prediction_step(model))
        self._checks_of = partial(loop_checks, model, dict(settings))
        self._further = layout.further
        self._kept = round(WINDOW * settings["rate"])
        self._writer = JointWriter(Slots(layout.estimate(tuple(self.estimator.tuning.followed))), signature)
        self.begin()
        for k in range(1, 4):  # compiles, and has seen it all once before it matters
            self.pack(self.update((k - 1) / settings["rate"]), round(k * SECOND), blind=False)
        self.begin()

    def begin(self) -> None:
        """Forget all estimates and counts."""
        self.estimator.begin()
        self.innovations: deque[float] = deque(maxlen=self._kept)
        self.parameters: Mapping[str, float] = {}
        self.checks = self._checks_of()
        """What extensions watch in a running loop."""

    def see(self, measured: Sequence[Measured]) -> None:
        """Use measurements that another adapter has answered, to continue from its state."""
        for time, given in measured:
            self.given[:] = given
            with suppress(UserError):  # there is no reading yet
                self.note(self.update(time))

    def update(self, time: float) -> StateEstimate:
        """Estimate with ``given`` at a time [s]. Raises UserError where there is no reading yet."""
        applied = np.where(np.isnan(self.applied), self.commanded, self.applied)
        return self.estimator.update(time, self.outputs, applied)

    def pack(self, estimate: StateEstimate, stamp: int, *, blind: bool) -> bytes:
        """The message of an estimate with its stamp [ns]; blind: it is a guess that must not be used for control."""
        state, ahead, disturbance = estimate.state.tolist(), estimate.ahead.tolist(), estimate.disturbance.tolist()
        further: list[float] = []
        if self._further:
            further = self.estimator.expected(estimate, self.applied)[self._further].tolist()
        acting, doubt, without = self.estimator.acting(self.applied), self.estimator.doubt, self.estimator.without
        validity = [*acting.tolist(), doubt, float(without), float(self.estimator.reversal.reversed)]
        parameters = estimate.parameters.tolist()
        numbers = [*state, *further, *disturbance, *ahead, *disturbance, *validity, *parameters]
        return self._writer.pack(stamp, [math.nan] * len(numbers) if blind else numbers)

    def note(self, estimate: StateEstimate) -> None:
        """Keep innovation and parameters of an estimate, for the diagnostics."""
        if math.isfinite(estimate.normalised_innovation):
            self.innovations.append(estimate.normalised_innovation)
        self.parameters = dict(zip(self.estimator.tuning.followed, estimate.parameters, strict=True))
        for check in self.checks:
            check.see(estimate, self.applied)


class ControllerAdapter:
    """A controller with the layouts of estimates, references and plans. It is made beside a loop that uses another one.

    given: state and input disturbance when the command acts (n + m,), written by the caller; state, disturbance: its
    parts.
    """

    def __init__(self, rig: Rig, settings: Mapping[str, Any], signature: str, warn: Callable[[str], object]) -> None:
        """Load, check and compile. warn: receives warnings for the user. Raises UserError where parameters, model and
        policy don't fit each other.
        """
        self.rig, self.settings = rig, settings
        model, source = model_of(rig, settings)
        self.sources = {"model": source}
        if (folder := policy_folder(rig, settings)) is not None:
            self.sources["policy"] = ModelSource(folder)
        made = controller_of(rig, model, settings, warn)
        self.controller, self.problem = made.controller, made.problem
        estimates = extensions.loaded(made.estimates)(made.controller, rig, model) if made.estimates else None
        self.estimates: EstimateSource | None = estimates
        self.network, self.supervisor, self.doubt = made.network, made.supervisor, made.doubt
        self.ahead = round((model.system.delay + settings["latency"]) * SECOND)
        period, horizon = self.controller.period, self.controller.horizon
        self.grid = np.round(period * np.arange(1, horizon + 1) * SECOND).astype(np.int64)
        layout = SignalLayout(rig, model.system)
        states, inputs = len(layout.states), len(layout.inputs)
        self.estimated = Slots([place.ending(AHEAD) for place in (*layout.states, *layout.inputs)])
        self.given = np.zeros(states + inputs)
        self.state, self.disturbance = np.split(self.given, [states])
        self.outputs = Slots(layout.outputs)
        self.tracked = np.array(self.problem.output_weights) > 0.0
        correction = self.network.correction if self.network is not None else None
        names: tuple[str, ...] = correction.names if correction is not None else ()
        self.followed = Slots([SignalPlace(name, "position") for name in names])
        self.plans = TrajectoryWriter(Slots([*layout.states, *layout.inputs]), self.grid.tolist(), signature)
        self.writer = JointWriter(Slots(layout.inputs), signature)
        self.rest = np.array([actuator.rest for actuator in rig.actuators])
        self.times = self.grid / SECOND
        self.validity = Slots(layout.validity)
        self.guard = Guard(guard_settings(settings, rig, model.system))
        self.incomplete = False
        """Whether the newest estimate is without a sensor."""
        self._span = np.array([actuator.high - actuator.low for actuator in rig.actuators])
        self._warm_up(self.rest)

    def _warm_up(self, rest: Array) -> None:
        """Answer artificial states, which compiles and loads everything that is used.

        The first answers are late, since they compile; later ones are as in the loop.
        """
        for _ in range(WARM_UPS):
            began = perf_counter()
            plan = self.controller.control(
                self.state, self.disturbance, rest, np.zeros((len(self.grid), len(self.outputs)))
            )
            self.writer.pack(0, plan.input.tolist())
            self.controller.prepare(self.controller.period)
            if perf_counter() - began > COMPILING:
                gc.collect()  # memory of the compiler, before it needs as much again
        self.begin()

    def begin(self) -> None:
        """Begin a new experiment."""
        self.controller.reset()
        self.guard.begin()
        if self.supervisor is not None:
            self.supervisor.reasons.clear()

    def check_changed(self, names: frozenset[str]) -> None:
        """Raise UserError where one of these parameters can't be changed because the network was trained with it."""
        if self.network is not None and (kept := sorted(names & OF_PROBLEM)):
            raise UserError(
                f"parameter {kept[0]}: the network keeps the one that it was trained with; policy exact uses it"
            )

    def judge(self, joints: JointStates, elapsed: float) -> LoopState:
        """The level that the guard allows after an estimate, ``elapsed`` [s] after the one before."""
        *applied, doubt, without, turned = self.validity.read(joints.names, joints.lists)
        self.incomplete = without > 0.0
        return self.guard.judge(doubt, without, turned, np.array(applied), self.disturbance, self.state, elapsed)

    def at_rest(self) -> Array:
        """Inputs at rest (m,) for the newest state; see :meth:`.guard.Guard.rest_of`."""
        return self.guard.rest_of(self.controller, self.state, self.rest)

    def nearer_rest(self, inputs: Array, share: float) -> Array:
        """Inputs (m,) moved towards :meth:`at_rest` by at most a share of their range."""
        rest = self.at_rest()
        away = inputs - rest
        return np.asarray(rest + np.sign(away) * np.maximum(np.abs(away) - share * self._span, 0.0))

    def adapt(self, parameters: list[float]) -> None:
        """Give a network with a correction the estimator's followed parameters; NaN leaves one unchanged."""
        if self.network is not None:
            self.network.adapt(dict(zip(self.followed.names, parameters, strict=True)))
