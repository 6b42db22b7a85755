"""The supervisor: a network drives while its plans pass the online check, the exact MPC where they don't.

Source of the check: Hose, Köhler, Zeilinger, Trimpe (2025), Approximate nonlinear model predictive control with
safety-augmented neural networks, IEEE TCST 33(6), algorithm 1; there the cost must fall, here it may rise within a
stated tolerance, since reference and disturbance change and a network is never exact.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from hybrid_sysid_ros.control.controller import MpcSolution, Status, held
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel, new_instance
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.mpc.shooting import bound_inputs, follow
from hybrid_sysid_ros.control.policy.kernels import Packed, inside, network_answer
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError

ACCEPTED, OUT_OF_RANGE, DISTURBED, INFEASIBLE, COSTLIER, WAITING, IMPROVED = range(7)
REASONS = (
    "accepted",
    "out of range",
    "disturbance too large",
    "not feasible",
    "costlier than the shifted plan",
    "waiting for good answers",
    "improved by one step",
)
"""Results of a check; waiting: at the beginning, when there is no last plan to compare with, and after a rejection."""
REJECTIONS = tuple(REASONS[k] for k in (OUT_OF_RANGE, DISTURBED, INFEASIBLE, COSTLIER, IMPROVED))
"""Those that say why an answer of the network was not used."""

INPUT_ROUNDING = 1e-9
"""Largest distance of an input from its bounds [its unit]."""


class Tolerances(NamedTuple):
    """Tolerances within which a plan is accepted."""

    cost: float
    """Share by which a plan may cost more than the shifted one."""
    floor: float
    """Amount by which it may always cost more, in the unit of the cost."""
    violation: float
    """Largest distance of a state from its bounds [its unit]."""
    disturbance: Numbers
    """(m,), largest input disturbance, or one for all inputs."""
    patience: int
    """Instances in a row that the network must answer well after a rejection, before it drives again, where no steps
    are made."""
    step: Numbers = (math.inf,)
    """(m,), by how much a step of the exact MPC may move an input of the last plan, and the network's first input may
    differ from that step's, or one for all [their unit]; where it is infinite, no step is made."""
    noise: float = 1.0
    """By how much the network's first input, followed by the rest of that step's plan, may cost more than this plan, in
    shares of ``floor`` for one of the horizon's samples. It adds up along a loop, and what it does to the state may
    cost more later, for example where a contact sticks or not."""


STEPS = 2
"""Most steps of the exact MPC after which the last plan must stand still, where steps are made."""


@kernel
def answer(policy: Packed, horizon: Horizon, instance: Instance, flat: Array, disturbance: Array, inputs: Array) -> int:
    """Write a policy's plan for an instance to ``inputs``; accepted where the instance is within the training range,
    its disturbance is not larger than ``disturbance`` (m,), and the plan keeps the bounds of inputs and their changes.
    """
    sizes, numbers = policy
    if not network_answer(sizes, numbers, flat, inputs):
        return OUT_OF_RANGE
    for j in range(disturbance.shape[0]):
        if not abs(instance.disturbance[j]) <= disturbance[j]:
            return DISTURBED
    if not inside(sizes, numbers, flat):
        return OUT_OF_RANGE
    return ACCEPTED if _bounded(instance, horizon, inputs) else INFEASIBLE


@kernel
def compare(
    prediction: PredictionModel,
    horizon: Horizon,
    instance: Instance,
    known: Array,
    limits: tuple[float, float, float],
    inputs: Array,
    states: Array,
) -> int:
    """Compare a plan with a ``known`` one; its simulated states are written to ``states``.

    limits: share and floor of the cost, and violation. It is accepted where its simulation is finite, keeps the bounds
    of states within the violation, and costs no more. The known plan's own violation does not count: otherwise each
    plan could violate bounds a little more than the last, and after a push the exact MPC may find a plan without a
    violation.
    """
    share, floor, violation = limits
    known_cost, _ = follow(prediction, horizon.weights, instance, known, states)
    cost, outside = follow(prediction, horizon.weights, instance, inputs, states)
    if not math.isfinite(cost) or outside > violation:
        return INFEASIBLE
    if not math.isfinite(known_cost):
        return ACCEPTED
    return COSTLIER if cost > (1.0 + share) * known_cost + floor else ACCEPTED


@inner
def _bounded(instance: Instance, horizon: Horizon, inputs: Array) -> bool:
    """Whether inputs and their changes are within their bounds."""
    limits = horizon.limits
    for j in range(inputs.shape[1]):
        low, high, rate = limits.low[j], limits.high[j], limits.rate[j] + INPUT_ROUNDING
        before = min(max(instance.previous[j], low), high)
        for i in range(inputs.shape[0]):
            u = inputs[i, j]
            if not (low - INPUT_ROUNDING <= u <= high + INPUT_ROUNDING and abs(u - before) <= rate):
                return False
            before = u
    return True


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
"""The layer of an answer by its status."""

TIME_ROUNDING = 1e-6
"""Rounding of times, in periods."""


class Supervisor:
    """Layers: the network -> the exact MPC with its time limit -> the rest of the last plan -> the last inputs.

    Changes of layer are bumpless: every layer gets the inputs that were really applied, the exact MPC begins with the
    last plan, and the rest of that plan is used where it is late. Without steps the network drives again after several
    good answers in a row, so that layers don't chatter. The first plan is the exact MPC's, since a check against a bad
    plan is meaningless. The warm start has the same source as the check.

    The last plan is the one that was applied, or where steps are made, the exact MPC's own: while the network drives,
    it solves each instance in :meth:`prepare`, after the input was sent, and in real time the step is its plan. The
    problem may have several local solutions: so the exact MPC takes over with the one that it has followed, not with
    the one that the network happens to be near.

    layers, reasons: how often each layer answered, and each result of the check, since the start.
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
        self._step = np.array(tolerances.step, dtype=float)
        self._steps = bool(np.isfinite(self._step).any())
        share, floor = float(tolerances.cost), float(tolerances.floor)
        if self._steps:
            share, floor = 0.0, float(tolerances.noise) * floor / policy.horizon
        self._disturbance, self._limits = most, (share, floor, float(tolerances.violation))
        self._patience = 0 if self._steps else tolerances.patience
        self._flat, self._instance = new_instance(mpc.system, policy.problem)
        self._inputs = np.zeros((policy.horizon, policy.inputs))
        self._states = np.zeros((policy.horizon + 1, policy.states))
        self.layers: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.reason = WAITING
        """Result of the last check."""
        self.reset()

    def reset(self) -> None:
        """Forget the last plan; counts stay."""
        self.mpc.reset()
        self.policy.reset()
        self._age, self._waiting = 0.0, 0
        self._inputs.fill(math.nan)
        self._unsolved = False

    def prepare(self, elapsed: float) -> None:
        """Shift the last plan by the time until the next call [s]; where the network drives with steps, the exact MPC
        makes that plan first.
        """
        self._age += elapsed
        if self._unsolved:
            self.mpc.control(*self._instance)
            self._unsolved = False
        self.mpc.prepare(elapsed)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`."""
        self._unsolved = False
        reason = self.reason = self.check(state, disturbance, previous_input, preview)
        if reason == ACCEPTED:
            self._age = 0.0
            inputs, states = self._inputs.copy(), self._states
            if not self._steps:
                self.mpc.adopt(disturbance, inputs, states)
            plan = MpcSolution(input=inputs[0], inputs=inputs, states=states[1:].copy(), status=Status.POLICY)
        else:
            plan = self._fallback(state, disturbance, previous_input, preview)
            if self._waiting > 0 and reason == WAITING:
                self._waiting -= 1
        self.layers[LAYERS[plan.status]] += 1
        self.reasons[REASONS[reason]] += 1
        return plan

    def check(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> int:
        """Decide whether the network drives: one of the results, see :func:`answer` and :func:`compare`."""
        if self.mpc.cold:
            return WAITING
        self._instance.assign(state, disturbance, previous_input, preview)
        horizon = self.mpc.shooting.horizon
        asked = self._instance, self._flat, self._disturbance
        reason = int(answer(self.policy.packed, horizon, *asked, self._inputs))
        if reason == ACCEPTED:
            reason = self._stepped() if self._steps else self._compared(horizon.inputs)
        if reason != ACCEPTED:
            self._waiting = self._patience
        elif self._waiting > 0:
            return WAITING
        return reason

    def _compared(self, known: Array) -> int:
        """The result for the network's plan beside a known one (N, m)."""
        shooting = self.mpc.shooting
        parts = shooting.prediction, shooting.horizon, self._instance
        return int(compare(*parts, known, self._limits, self._inputs, self._states))

    def _stepped(self) -> int:
        """IMPROVED unless some steps of the exact MPC leave the last plan nearly as it is, and the network agrees with
        the last of them: in its first inputs and, but for the noise that is allowed, in the cost that these lead to.

        A plan that a step moves, if only later on, may be far from the solution, so that nobody knows what the network
        should have answered. Of the network's plan only the first inputs are applied, and the exact MPC goes on from
        its own: so its plan follows them, and what this costs bounds what they can cost. The last plan stays as it was,
        but for one in real time that they agree with: these steps are all there is.
        """
        horizon = self.mpc.shooting.horizon
        inputs, states, under = horizon.inputs.copy(), horizon.states.copy(), horizon.disturbance.copy()
        reason = IMPROVED
        for _ in range(STEPS):
            last = horizon.inputs.copy()
            first = self.mpc.step(*self._instance)
            if first is None:
                break
        if first is not None and self._near(horizon.planned, last) and self._near(first, self._inputs[0]):
            self._inputs[1:] = horizon.planned[1:]
            bound_inputs(horizon, self._instance.previous, self._inputs)
            reason = self._compared(horizon.planned)
        if not (reason == ACCEPTED and self.mpc.real_time):
            self.mpc.adopt(under, inputs, states)
            self._unsolved = reason == ACCEPTED
        return IMPROVED if reason == COSTLIER else reason

    def _near(self, one: Array, other: Array) -> bool:
        """Whether inputs (m,), or plans (N, m), differ by no more than the tolerance of a step."""
        return bool((np.abs(one - other) <= self._step).all())

    def _fallback(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """The exact MPC's plan, or the rest of the last one, or the last applied inputs."""
        plan = self.mpc.control(state, disturbance, previous_input, preview)
        if plan.status not in (Status.LATE, Status.FAILED):
            self._age = 0.0
            return plan
        if self.mpc.cold or self._age > (self.horizon - TIME_ROUNDING) * self.period:
            return held(previous_input, self.mpc.problem, Status.HELD)
        return plan
