"""The supervisor: a network drives while its plans pass the online check, the exact MPC where they don't."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Plan, Status
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.online_check import ACCEPTED, REASONS, WAITING, Tolerances, online_check, trial
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

LAYERS = {
    Status.POLICY: "policy",
    Status.SOLVED: "exact",
    Status.ITERATED: "exact",
    Status.NOT_CONVERGED: "exact",
    Status.LATE: "shifted plan",
    Status.FAILED: "shifted plan",
    Status.FEEDBACK: "feedback",
    Status.HELD: "held",
}
"""What stands behind an answer, by its status."""


class Supervisor:
    """Layers: the network -> the exact MPC with its time limit -> the rest of the last plan -> the last input.

    Changes of layer are bumpless: every layer is told the input that was really applied, the exact MPC begins at the
    plan that was applied last, whoever made it, and what is left of that plan is what stands in where it is late. After
    a rejection the network drives again once it has answered well some times in a row, so layers don't chatter. The
    first plan is the exact MPC's, for a check against a bad plan means little.
    Source of the check and of the warm start: see :mod:`~.online_check`.

    layers, reasons: how often each layer answered and what the check found, since the start.
    """

    def __init__(self, policy: Policy, mpc: ExactMpc, tolerances: Tolerances) -> None:
        """Raises UserError where policy and MPC have different problems, or the policy gives its first input alone."""
        if policy.problem != mpc.problem:
            raise UserError(
                "supervisor: the policy imitates another problem than that of the exact MPC; train it again"
            )
        self.policy = policy
        self.mpc = mpc
        self.horizon = mpc.horizon
        self.period = mpc.period
        self._tolerances = tolerances
        self._trial = trial(policy)
        self._check = online_check(mpc.system, policy).check
        self._range = policy.training_range.packed
        self._question = np.zeros(policy.states + 2 + policy.horizon)
        self.layers: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget the past; what was counted stays."""
        self.mpc.reset()
        self.policy.reset()
        self._trial.waiting[0] = 0
        self._age = 0.0

    def prepare(self, elapsed: float) -> None:
        """Move the last plan on by the time until the next call [s]."""
        self._age += elapsed
        self.mpc.prepare(elapsed)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`."""
        question, states, shooting = self._question, self.policy.states, self.mpc.shooting
        question[:states] = state
        question[states] = disturbance[0]
        question[states + 1] = previous_input[0]
        question[states + 2 :] = preview.ravel()
        applied = self._within(float(previous_input[0]))
        reason = WAITING
        if not self.mpc.cold:
            reason = self._check(
                question,
                self.policy.memory,
                self._range,
                shooting.prediction,
                shooting.horizon,
                self._tolerances,
                self._trial,
            )
        if reason == ACCEPTED:
            self._age = 0.0
            self.mpc.adopt(disturbance, self._trial.inputs, self._trial.states)
            inputs, planned = self._trial.inputs.copy(), self._trial.states[1:].copy()
            plan = Plan(input=inputs[0], inputs=inputs, states=planned, status=Status.POLICY)
        else:
            plan = self._fallback(state, disturbance, previous_input, preview, applied)
        self.layers[LAYERS[plan.status]] += 1
        self.reasons[REASONS[reason]] += 1
        return plan

    def _fallback(
        self, state: Array, disturbance: Array, previous_input: Array, preview: Array, applied: float
    ) -> Plan:
        """The exact MPC's plan, or what is left of the last one, or the input applied last."""
        plan = self.mpc.control(state, disturbance, previous_input, preview)
        if plan.status not in (Status.LATE, Status.FAILED):
            self._age = 0.0
            return plan
        if self.mpc.cold or self._age >= self.horizon * self.period:
            inputs = np.full((self.horizon, 1), applied)
            return Plan(input=inputs[0], inputs=inputs, states=plan.states[:0], status=Status.HELD)
        # The plan was made for another input before it, where something else drove the rig meanwhile.
        rate = self.mpc.problem.rate_limits[0]
        first = np.clip(plan.input, applied - rate, applied + rate) if math.isfinite(rate) else plan.input
        return plan._replace(input=first)

    def _within(self, value: float) -> float:
        limit = self.mpc.problem.input_high[0]
        return min(max(value, -limit), limit) if math.isfinite(value) else 0.0
