"""Guarded controller: a controller behind a guard, as the node drives it, for loops in one process."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.control.controller import Controller, MpcSolution
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.control.safety.guard import Guard
from hybrid_sysid_ros.estimation.estimator import StateEstimate
from hybrid_sysid_ros.estimation.monitored_estimator import MonitoredEstimator
from hybrid_sysid_ros.support.arrays import Array


class GuardedController:
    """Answers the estimates of a monitored estimator: follows the reference, slows down, holds or rests.

    level: what the guard allowed last. plan: the controller's newest, None at rest. input: the newest command (m,).
    times: of the preview, from when the command acts on (horizon,) [s].
    """

    def __init__(
        self, controller: Controller, guard: Guard, estimator: MonitoredEstimator, *, rest: Array, lead: float
    ) -> None:
        """rest: the inputs at rest (m,). lead: time from a measurement until its command acts [s]."""
        self.controller, self.guard, self.estimator, self.lead = controller, guard, estimator, lead
        self.times: Array = controller.period * np.arange(1, controller.horizon + 1, dtype=np.float64)
        self._rest = rest
        self.begin()

    def begin(self) -> None:
        """Forget the past."""
        self.controller.reset()
        self.guard.begin()
        self.level, self.input, self._returning = LoopState.DRIVING, self._rest.copy(), False
        self.plan: MpcSolution | None = None

    def control(self, estimate: StateEstimate, applied: Array, now: Array, preview: Array, elapsed: float) -> Array:
        """:meth:`answer`, and :meth:`prepare` for the next one."""
        command = self.answer(estimate, applied, now, preview, elapsed)
        self.prepare(elapsed)
        return command

    def answer(self, estimate: StateEstimate, applied: Array, now: Array, preview: Array, elapsed: float) -> Array:
        """The command (m,) for an estimate, ``elapsed`` [s] after the one before. applied (m,): inputs that acted. now
        (p,), preview (horizon, p): the reference when the command acts, and at ``times`` from then on [SI].
        """
        guard, estimator, state, disturbance = self.guard, self.estimator, estimate.ahead, estimate.disturbance.copy()
        validity = estimator.doubt, estimator.without, estimator.reversal.reversed
        self.level = level = guard.judge(*validity, estimator.acting(applied), disturbance, state, elapsed)
        before = guard.turned(self.input)
        rest = guard.rest_of(self.controller, state, self._rest)
        if level is LoopState.RESTING:
            self._returning, self.plan = True, None
            command = rest
        else:
            found = estimator.expected(estimate, applied)
            if self._returning:
                self._returning = False
                self.controller.reset()
                guard.come_back(found)
            preview = guard.reference(level, now, found, preview, self.times, elapsed)
            self.plan = plan = self.controller.control(state, disturbance, before, preview)
            command = guard.slowed(plan.input, rest) if guard.slows else plan.input
        acting = guard.followed(command, before, elapsed)
        guard.commanded(acting)
        self.input = guard.turned(acting)
        return self.input

    def prepare(self, elapsed: float) -> None:
        """Prepare the next answer, ``elapsed`` [s] after this one."""
        if self.plan is not None:
            self.controller.prepare(elapsed)
