"""The supervisor: a network drives while its plans pass the online check, the exact MPC where they don't.

Source of the check: Hose, Köhler, Zeilinger, Trimpe (2025), Approximate nonlinear model predictive control with
safety-augmented neural networks, IEEE TCST 33(6), algorithm 1; there the cost must fall, here it may rise within a
stated tolerance, since reference and disturbance change and a network is never exact.
"""

from __future__ import annotations

import math
from collections import Counter
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hybrid_sysid_ros.control.controller import MpcSolution, Status, held
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel, new_instance
from hybrid_sysid_ros.control.mpc.linearisation import set_stage
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.mpc.shooting import follow
from hybrid_sysid_ros.control.policy.kernels import Packed, inside, network_answer
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.supervision import SUPERVISION, SupervisorMemory
from hybrid_sysid_ros.core.call import call_value
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
    """Instances in a row that the network must answer well after a rejection, before it drives again."""
    step: Numbers = (math.inf,)
    """(m,), by how much one step of the exact MPC may move an input of the last plan, and the network's first input may
    differ from that step's, or one for all [their unit]; where it is infinite, no step is made."""
    noise: float = 1.0
    """By how much the network's plan may cost more than that step's, in shares of ``floor`` for one of the horizon's
    samples. It adds up along a loop, and what it does to the state may cost more later, for example where a contact
    sticks or not."""


@kernel
def check(
    policy: Packed,
    prediction: PredictionModel,
    horizon: Horizon,
    instance: Instance,
    flat: Array,
    limits: tuple[Array, float, float, float],
    inputs: Array,
    states: Array,
    costs: Array,
) -> int:
    """Check a policy's plan against the shifted one in the horizon of an exact MPC; the plan and its simulated states
    are written to ``inputs`` and ``states``, its cost to ``costs`` (1,). limits: those of disturbance, share and floor
    of the cost, and violation.

    It is accepted where the instance is within the training range, the disturbance is not too large, and the plan's
    simulation is finite, keeps the bounds of inputs, of their changes and, within the tolerance, of states, and costs
    no more. The shifted plan's own violation does not count: otherwise each plan could violate bounds a little more
    than the last, and after a push the exact MPC may find a plan without a violation.
    """
    sizes, numbers = policy
    disturbance, share, floor, violation = limits
    if not network_answer(sizes, numbers, flat, inputs):
        return OUT_OF_RANGE
    for j in range(disturbance.shape[0]):
        if not abs(instance.disturbance[j]) <= disturbance[j]:
            return DISTURBED
    if not inside(sizes, numbers, flat):
        return OUT_OF_RANGE
    if not _bounded(instance, horizon, inputs) or not _allowed(prediction, horizon, instance, inputs):
        return INFEASIBLE
    weights = horizon.weights
    shifted_cost, _ = follow(prediction, weights, instance, horizon.inputs, states)
    costs[0], outside = follow(prediction, weights, instance, inputs, states)
    if not math.isfinite(costs[0]) or outside > violation:
        return INFEASIBLE
    if not math.isfinite(shifted_cost):
        return ACCEPTED
    return COSTLIER if costs[0] > (1.0 + share) * shifted_cost + floor else ACCEPTED


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


@inner
def _allowed(prediction: PredictionModel, horizon: Horizon, instance: Instance, inputs: Array) -> bool:
    """Whether inputs keep the bounds of terms that hold without exception, for which the states don't matter."""
    limits, weights, drive = horizon.limits, horizon.weights, horizon.work.drive
    values, hard = np.empty(weights.outputs.shape[1]), False
    for r in range(limits.hard.shape[0]):
        hard = hard or limits.hard[r]
    for i in range(inputs.shape[0] if hard else 0):
        for j in range(inputs.shape[1]):
            drive[j] = inputs[i, j] + instance.disturbance[j]
        set_stage(prediction, i, instance.disturbance, drive)
        call_value(
            prediction.output,
            instance.state,
            drive,
            prediction.parameters,
            prediction.network,
            prediction.h,
            0.0,
            values,
        )
        for r in range(limits.values.shape[0]):
            k = limits.values[r]
            beyond = max(values[k] - weights.value_high[i, k], weights.value_low[i, k] - values[k])
            if limits.hard[r] and not beyond <= INPUT_ROUNDING:
                return False
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
    last plan, and the rest of that plan is used where it is late. After a rejection the network drives again after
    several good answers in a row, so that layers don't chatter. The first plan is the exact MPC's, since a check
    against a bad plan is meaningless; where steps are made, the first several are, since from a cold start it may take
    more than one. The warm start has the same source as the check.

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
        self._limits = most, float(tolerances.cost), float(tolerances.floor), float(tolerances.violation)
        self._patience = tolerances.patience
        self._noise = float(tolerances.noise * tolerances.floor) / policy.horizon
        self._step = np.array(tolerances.step, dtype=float)
        self._steps = bool(np.isfinite(self._step).any())
        self._flat, self._instance = new_instance(mpc.system, policy.problem)
        self._inputs = np.zeros((policy.horizon, policy.inputs))
        self._states = np.zeros((policy.horizon + 1, policy.states))
        self._cost = np.full(1, math.inf)
        self.layers: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.reason = WAITING
        """Result of the last check."""
        if self._steps:  # compiled now, not when the network is first about to drive
            mpc.step(*self._instance)
            mpc.follow(self._inputs)
        self.reset()

    @cached_property
    def compiled(self) -> SupervisorMemory:
        """The same supervisor for compiled code, which remembers its own last calls."""
        (most, share, floor, violation), (sizes, numbers) = self._limits, self.policy.packed
        return SupervisorMemory(
            mpc=self.mpc.compiled,
            sizes=sizes,
            numbers=numbers,
            disturbance=most,
            share=share,
            floor=floor,
            violation=violation,
            patience=self._patience,
            noise=self._noise,
            steps=int(self._steps),
            step=np.broadcast_to(self._step, most.shape).copy(),
            flat=self._flat,
            inputs=self._inputs,
            states=self._states,
            cost=self._cost,
            kept_inputs=np.zeros_like(self._inputs),
            kept_states=np.zeros_like(self._states),
            kept_disturbance=np.zeros_like(most),
            course=np.zeros(1, SUPERVISION),
        )

    def reset(self) -> None:
        """Forget the last plan; counts stay."""
        self.mpc.reset()
        self.policy.reset()
        self._age, self._waiting = 0.0, self._patience if self._steps else 0
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
                self._waiting = self._waiting - 1 if self._near(plan.input, self._inputs[0]) else self._patience
        self.layers[LAYERS[plan.status]] += 1
        self.reasons[REASONS[reason]] += 1
        return plan

    def check(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> int:
        """Decide whether the network drives: one of the results, see :func:`check`."""
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
            self._cost,
        )
        reason = int(check(self.policy.packed, *parts))
        if reason == ACCEPTED and self._steps and self._waiting == 0:
            reason = self._stepped(state, disturbance, previous_input, preview)
        if reason != ACCEPTED:
            self._waiting = self._patience
        elif self._waiting > 0:
            return WAITING
        return reason

    def _stepped(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> int:
        """IMPROVED unless one step of the exact MPC leaves the last plan nearly as it is, and the network agrees with
        it in its first inputs and, but for the noise that is allowed, in its cost.

        A plan that a step moves, if only later on, may be far from the solution, so that nobody knows what the network
        should have answered. The last plan stays as it was, but for one in real time that they agree with: this step is
        all there is.
        """
        horizon = self.mpc.shooting.horizon
        inputs, states, under = horizon.inputs.copy(), horizon.states.copy(), horizon.disturbance.copy()
        first = self.mpc.step(state, disturbance, previous_input, preview)
        near = first is not None and self._near(horizon.planned, inputs) and self._near(first, self._inputs[0])
        near = near and self._cost[0] <= self.mpc.follow(horizon.planned)[0] + self._noise
        if not (near and self.mpc.real_time):
            self.mpc.adopt(under, inputs, states)
            self._unsolved = near
        return ACCEPTED if near else IMPROVED

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
