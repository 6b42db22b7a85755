"""Guarded controller: a controller behind a guard, as the node drives it, for loops in one process."""

from __future__ import annotations

import math

import numpy as np

from hybrid_sysid_ros.control.controller import Controller, MpcSolution, Status
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.control.safety.guard import Guard
from hybrid_sysid_ros.estimation.estimator import StateEstimate
from hybrid_sysid_ros.estimation.monitored_estimator import MonitoredEstimator
from hybrid_sysid_ros.support.arrays import Array

NO_ANSWERS = (Status.FAILED, Status.HELD)
"""Statuses of plans that stand in for an answer."""


class GuardedController:
    """Answers the estimates of a monitored estimator: follows the reference, slows down, holds or rests.

    level: what the guard allowed last. plan: the controller's newest, None without one. rests: whether the inputs
    rest. input: the newest command (m,). times: of the preview, from when the command acts on (horizon,) [s].
    """

    def __init__(
        self, controller: Controller, guard: Guard, estimator: MonitoredEstimator, *, rest: Array, lead: float,
        turn: float = 0.0, zero_after: float = math.inf,
    ) -> None:  # fmt: skip
        """rest: the inputs at rest (m,). lead: time from a measurement until its command acts [s]. turn: time of an
        answer [s]; without a sound one for zero_after [s] the inputs rest.
        """
        self.controller, self.guard, self.estimator, self.lead = controller, guard, estimator, lead
        self._turn, self._zero_after = turn, zero_after
        self.times: Array = controller.period * np.arange(1, controller.horizon + 1, dtype=np.float64)
        self._rest = rest
        self.begin()

    def begin(self) -> None:
        """Forget the past."""
        self.controller.reset()
        self.guard.begin()
        self.level, self.input, self._returning = LoopState.DRIVING, self._rest.copy(), False
        self.plan: MpcSolution | None = None
        self.rests, self._lost = False, 0.0

    def control(self, estimate: StateEstimate, applied: Array, now: Array, preview: Array, elapsed: float) -> Array:
        """:meth:`answer`, and :meth:`prepare` for the next one."""
        command = self.answer(estimate, applied, now, preview, elapsed)
        self.prepare(elapsed)
        return command

    def answer(
        self,
        estimate: StateEstimate,
        applied: Array,
        now: Array,
        preview: Array,
        elapsed: float,
        *,
        blind: bool = False,
    ) -> Array:
        """The command (m,) for an estimate, ``elapsed`` [s] after the one before. applied (m,): inputs that acted. now
        (p,), preview (horizon, p): the reference when the command acts, and at ``times`` from then on [SI]. blind: the
        estimate is too old for an answer: the last command is held.
        """
        guard, estimator, state, disturbance = self.guard, self.estimator, estimate.ahead, estimate.disturbance.copy()
        validity = estimator.doubt, estimator.without, estimator.reversal.reversed
        self.level = level = guard.judge(*validity, estimator.acting(applied), disturbance, state, elapsed)
        before = guard.turned(self.input)
        rest = guard.rest_of(self.controller, state, self._rest)
        self.rests = level is LoopState.RESTING
        if self.rests:
            self.plan, command, self._lost = None, rest, 0.0
        elif blind:
            command, self._lost = before, self._lost + self._turn
        else:
            found = estimator.expected(estimate, applied)
            if self._returning:
                self._returning = False
                self.controller.reset()
                guard.come_back(found)
            preview = guard.reference(level, now, found, preview, self.times, elapsed)
            self.plan = plan = self.controller.control(state, disturbance, before, preview)
            command = guard.slowed(plan.input, rest) if guard.slows else plan.input
            self._lost = 0.0 if plan.status not in NO_ANSWERS else self._lost + self._turn
        if self._lost > self._zero_after:
            self.rests, command = True, rest
        self._returning = self._returning or self.rests
        acting = guard.followed(command, before, elapsed)
        guard.commanded(acting)
        self.input = guard.turned(acting)
        return self.input

    def prepare(self, elapsed: float) -> None:
        """Prepare the next answer, ``elapsed`` [s] after this one."""
        if self.plan is not None and not self.rests:
            self.controller.prepare(elapsed)
