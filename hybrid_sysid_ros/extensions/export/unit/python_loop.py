"""The loop in Python that a unit must answer as."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import Controller, ExactMpc
from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.control.mpc.calls import HELD
from hybrid_sysid_ros.control.mpc.mpc import STATUSES
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.guard import Guard
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.control.waiting_inputs import InputsOnTheirWay, WaitingInputs
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter, estimator_class
from hybrid_sysid_ros.estimation.measurement_sequence import LARGEST_INPUT
from hybrid_sysid_ros.estimation.monitored_estimator import MonitoredEstimator
from hybrid_sysid_ros.extensions.export.unit.built import PeriodAnswer
from hybrid_sysid_ros.extensions.export.unit.printed_loop import RESTED, WAITING
from hybrid_sysid_ros.extensions.shared.guarded_controller import GuardedController
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults, estimator_model, guard_settings
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.estimators import estimator_of, prediction_step
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RESTART = 1.0
"""A stamp this far before the newest one begins time anew, or is a fault [s]."""
LARGEST_STAMP = 1e11
"""Of a clock [s]; a double tells microseconds there."""
CODES = {status: code for code, status in STATUSES.items()}
"""In C, by their names in Python."""


@dataclass(kw_only=True, eq=False)
class PythonLoop:
    """The loop in Python: its estimator and controller, and what watches them. mpc: the one in the controller, without
    a time limit.
    """

    monitored: MonitoredEstimator
    guarded: GuardedController
    mpc: ExactMpc
    supervisor: Supervisor | None
    limits: tuple[Array, Array]
    """Lowest and highest command (m,)."""
    reach: Array
    """Lowest and highest reference (2, p)."""
    stale_after: float
    """Without a newer measurement for this time the last command is held [s]."""
    zero_after: float
    """Without a sound answer for this time the inputs rest [s]."""

    @property
    def estimator(self) -> ExtendedKalmanFilter:
        """The filter."""
        assert isinstance(self.monitored.filter, ExtendedKalmanFilter)
        return self.monitored.filter

    @property
    def controller(self) -> Controller:
        """What answers while nothing is in doubt."""
        return self.guarded.controller

    @property
    def iterates(self) -> bool:
        """Whether an answer may iterate to convergence, which rounding changes more than one real-time iteration."""
        return not self.mpc.real_time or self.supervisor is not None

    @property
    def on_way(self) -> InputsOnTheirWay | None:
        """What waits where inputs have different delays."""
        return self.controller.on_way if isinstance(self.controller, WaitingInputs) else None

    @property
    def command(self) -> Array:
        """The newest one (m,)."""
        return self.guarded.input

    @command.setter
    def command(self, inputs: Array) -> None:
        self.guarded.input = inputs

    def reset(self) -> None:
        """Forget the past; the last command holds."""
        command = self.command
        self.monitored.begin()
        self.guarded.begin()
        self.command = command
        state, offset = np.zeros(len(self.mpc.system.states)), np.zeros(len(command))
        self._answer = PeriodAnswer(WAITING, command, state, state, offset, np.zeros(2))
        self._answered = self._back = math.nan
        self._stale = 0.0

    def step(self, time: float, outputs: Array, applied: Array, preview: Array) -> PeriodAnswer:
        """A period: outputs (p,), applied inputs (m,), preview (N, p)."""
        time = time if abs(time) <= LARGEST_STAMP else math.nan
        if self._begins_anew(time):
            self.reset()
        known = np.where(np.abs(applied) <= LARGEST_INPUT, applied, self.command)
        elapsed = 0.0
        if math.isfinite(time):
            first = math.isnan(self._answered)
            elapsed = self.estimator.period if first else max(time - self._answered, 0.0)
        try:
            estimate = self.monitored.update(time, outputs, known)
        except UserError:
            if not self.estimator._started:
                self._answer = self._answer._replace(status=WAITING)
                return self._answer
            estimate = self.estimator._look()
        self._stale += self.estimator.period
        if math.isfinite(time):
            self._stale = self._stale if time <= self._answered else 0.0
            self._answered = time if math.isnan(self._answered) else max(time, self._answered)
        preview, blind, loop = np.clip(preview, *self.reach), self._stale > self.stale_after, self.guarded
        command = loop.answer(estimate, applied, preview[0], preview, elapsed, blind=blind)
        status = RESTED if loop.rests else HELD if blind or loop.plan is None else CODES[loop.plan.status]
        judged = np.array([float(loop.level), loop.guard.memory.core[0].cause + 1])
        self._answer = PeriodAnswer(status, command, estimate.state, estimate.ahead, estimate.disturbance, judged)
        return self._answer

    def _begins_anew(self, time: float) -> bool:
        """Whether time begins anew: with the second stamp in a row that is long before the newest one."""
        before, self._back = self._back, time if time < self._answered - RESTART else math.nan
        return before < self._back < before + RESTART

    def sent(self, inputs: Array) -> None:
        """What the rig got is always what this loop has answered."""

    def prepare(self, elapsed: float) -> None:
        """Prepare for the next period."""
        if self._answer.status != WAITING:
            self.guarded.prepare(elapsed)


def loop_in_python(
    rig: Rig,
    model: Model,
    settings: Mapping[str, Any],
    network: Policy | None = None,
    estimation: Mapping[str, Any] | None = None,
) -> PythonLoop:
    """Estimator and controller of a rig from the parameters of the nodes. settings, estimation: some of the
    controller's and of the estimator's. network: the policy that drives, if it is not read from the folder that they
    name.

    Raises UserError for a method, a solver or a model that can't be printed.
    """
    values = defaults(rig, "estimator") | dict(estimation or {})
    given = defaults(rig, "controller") | {"policy": "exact"} | dict(settings) | {"lockstep": True}
    if estimator_class(values["method"]) is not ExtendedKalmanFilter:
        raise UserError(f"the estimator's method {values['method']} can't be printed as C; set method to ekf")
    if given["solver"] != "sqp" or given["policy"] == "network":
        raise UserError(
            f"solver {given['solver']} with policy {given['policy']} can't be printed as C: give solver sqp "
            "and policy exact or supervised"
        )
    model = estimator_model(rig, model)
    made = controller_of(rig, model, given, network=network)
    inner = made.controller.controller if isinstance(made.controller, Cascade | WaitingInputs) else made.controller
    mpc = made.supervisor.mpc if made.supervisor else inner
    if not isinstance(mpc, ExactMpc):
        raise UserError(f"a {type(inner).__name__} can't be printed as C; give the exact MPC or a supervisor")
    monitored = estimator_of(rig, model.system, values, latency=given["latency"], step=prediction_step(model))
    rest = np.array([actuator.rest for actuator in rig.actuators])
    guard = Guard(guard_settings(given, rig, model.system))
    lead = model.system.delay + given["latency"]
    return PythonLoop(
        monitored=monitored,
        guarded=GuardedController(
            made.controller,
            guard,
            monitored,
            rest=rest,
            lead=lead,
            turn=monitored.filter.period,
            zero_after=given["zero_after"],
        ),
        mpc=mpc,
        supervisor=made.supervisor,
        reach=rig.reach,
        stale_after=given["stale_after"],
        zero_after=given["zero_after"],
        limits=rig.limits
        if isinstance(made.controller, Cascade)
        else (np.array(mpc.problem.input_low), np.array(mpc.problem.input_high)),
    )
