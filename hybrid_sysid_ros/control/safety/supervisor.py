"""The supervisor: a network drives while its plans pass the online check, the exact MPC where they don't."""

from __future__ import annotations

from collections import Counter

import numpy as np

from hybrid_sysid_ros.control.controller import Plan, Status, held
from hybrid_sysid_ros.control.mpc.horizon import new_instance
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.online_check import ACCEPTED, REASONS, WAITING, Tolerances, check
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

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

ROUNDING = 1e-6
"""Of times, in periods."""


class Supervisor:
    """Layers: the network -> the exact MPC with its time limit -> the rest of the last plan -> the last inputs.

    Changes of layer are bumpless: every layer is told the inputs that were really applied, the exact MPC begins at the
    plan that was applied last, whoever made it, and what is left of that plan is what stands in where it is late. After
    a rejection the network drives again once it has answered well some times in a row, so layers don't chatter. The
    first plan is the exact MPC's, for a check against a bad plan means little.
    Source of the check and of the warm start: see :mod:`~.online_check`.

    layers, reasons: how often each layer answered and what the check found, since the start.
    """

    def __init__(self, policy: Policy, mpc: ExactMpc, tolerances: Tolerances) -> None:
        """Raises UserError where policy and MPC have different problems, or the policy gives its first inputs alone."""
        if policy.stages != policy.horizon:
            raise UserError(
                f"policy: gives the inputs of {policy.stages} of {policy.horizon} intervals, so that it can't be "
                "checked or certified; train it to give the whole sequence, or use it alone and uncertified "
                "(policy:=network)"
            )
        if policy.problem != mpc.problem:
            raise UserError("policy: it imitates another problem than that of the exact MPC; train it again")
        self.policy = policy
        self.mpc = mpc
        self.horizon = mpc.horizon
        self.period = mpc.period
        most = np.broadcast_to(np.array(tolerances.disturbance, dtype=float), (policy.inputs,)).copy()
        self._limits = most, float(tolerances.cost), float(tolerances.floor), float(tolerances.violation)
        self._patience = tolerances.patience
        self._flat, self._instance = new_instance(mpc.system, policy.problem)
        self._inputs = np.zeros((policy.horizon, policy.inputs))
        self._states = np.zeros((policy.horizon + 1, policy.states))
        self.layers: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.reason = WAITING
        """What the last check found."""
        self.reset()

    def reset(self) -> None:
        """Forget the past; what was counted stays."""
        self.mpc.reset()
        self.policy.reset()
        self._age, self._waiting = 0.0, 0

    def prepare(self, elapsed: float) -> None:
        """Move the last plan on by the time until the next call [s]."""
        self._age += elapsed
        self.mpc.prepare(elapsed)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`."""
        reason = self.reason = self.check(state, disturbance, previous_input, preview)
        if reason == ACCEPTED:
            self._age = 0.0
            inputs, states = self._inputs.copy(), self._states
            self.mpc.adopt(disturbance, inputs, states)
            plan = Plan(input=inputs[0], inputs=inputs, states=states[1:].copy(), status=Status.POLICY)
        else:
            plan = self._fallback(state, disturbance, previous_input, preview)
        self.layers[LAYERS[plan.status]] += 1
        self.reasons[REASONS[reason]] += 1
        return plan

    def check(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> int:
        """One of the reasons, see :func:`~.online_check.check`: whether the network drives."""
        if self.mpc.cold:
            return WAITING
        self._instance.assign(state, disturbance, previous_input, preview)
        shooting = self.mpc.shooting
        parts = (
            shooting.prediction,
            shooting.horizon,
            self._instance,
            self._flat,
            self._limits,
            self._inputs,
            self._states,
        )
        reason = int(check(self.policy.packed, *parts))
        if reason != ACCEPTED:
            self._waiting = self._patience
        elif self._waiting > 0:
            self._waiting -= 1
            return WAITING
        return reason

    def _fallback(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """The exact MPC's plan, or what is left of the last one, or the inputs applied last."""
        plan = self.mpc.control(state, disturbance, previous_input, preview)
        if plan.status not in (Status.LATE, Status.FAILED):
            self._age = 0.0
            return plan
        if self.mpc.cold or self._age > (self.horizon - ROUNDING) * self.period:
            return held(previous_input, self.mpc.problem, Status.HELD)
        return plan
