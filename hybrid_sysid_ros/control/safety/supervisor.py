"""The supervisor: a network drives while its plans pass the online check, the exact MPC where they don't.

What it does in a period is in :mod:`~hybrid_sysid_ros.control.safety.supervision`.
"""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from typing import NamedTuple

import numpy as np

from hybrid_sysid_ros.control.controller import MpcSolution, Status
from hybrid_sysid_ros.control.mpc.calls import solve_within
from hybrid_sysid_ros.control.mpc.horizon import Instance, new_instance
from hybrid_sysid_ros.control.mpc.mpc import STATUSES, ExactMpc
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.supervision import (
    COSTLIER,
    DISTURBED,
    IMPROVED,
    INFEASIBLE,
    OUT_OF_RANGE,
    SUPERVISION,
    WAITING,
    SupervisorMemory,
    accept,
    accept_beside_step,
    begin_supervision,
    fall_back,
)
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError

REASONS = (
    "accepted",
    "out of range",
    "disturbance too large",
    "not feasible",
    "costlier than the shifted plan",
    "waiting for good answers",
    "improved by one step",
)
"""The words of each result of a check."""
REJECTIONS = tuple(REASONS[k] for k in (OUT_OF_RANGE, DISTURBED, INFEASIBLE, COSTLIER, IMPROVED))
"""Those that say why an answer of the network was not used."""


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


class Supervisor:
    """Layers: the network -> the exact MPC with its time limit -> the rest of the last plan -> the last inputs.

    Changes of layer are bumpless: every layer gets the inputs that were really applied, the exact MPC begins with the
    last plan, and the rest of that plan is used where it is late. After a rejection the network drives again after
    several good answers in a row, so that layers don't chatter. The first plan is the exact MPC's, since a check
    against a bad plan is meaningless; where steps are made, the first several are, since from a cold start it may take
    more than one. The warm start has the same source as the check.

    The last plan is the one that was applied, or where steps are made, the exact MPC's own: while the network drives,
    it solves each instance in :meth:`prepare`, after the input was sent. In real time its step comes first, answers
    where the network does not, and is what the network's plan is compared with. The
    problem may have several local solutions: so the exact MPC takes over with the one that it has followed, not with
    the one that the network happens to be near.

    layers, reasons: how often each layer answered, and each result of the check, since the start.
    """

    def __init__(self, policy: Policy, mpc: ExactMpc, tolerances: Tolerances) -> None:
        """Raises UserError where policy and MPC have different problems, the policy gives its first inputs alone, or
        the MPC's steps are not checked.
        """
        if policy.stages != policy.horizon:
            raise UserError(
                f"policy: gives the inputs of {policy.stages} of {policy.horizon} intervals, so that it can't be "
                "checked or certified; train it to give the whole sequence, or use it alone and uncertified "
                "(policy:=network)"
            )
        if policy.problem.sized(mpc.system) != mpc.problem:
            raise UserError("policy: it imitates another problem than that of the exact MPC; train it again")
        if not mpc.checked:
            raise UserError(
                "supervisor: it judges by the cost of simulated plans: make the exact MPC with checked=True"
            )
        self.policy = policy
        self.mpc = mpc
        self.horizon = mpc.horizon
        self.period = mpc.period
        most = np.broadcast_to(np.array(tolerances.disturbance, dtype=float), (policy.inputs,)).copy()
        flat, self.instance = new_instance(mpc.system, policy.problem)
        plan, path = (policy.horizon, policy.inputs), (policy.horizon + 1, policy.states)
        self.compiled = SupervisorMemory(
            mpc=mpc.compiled,
            sizes=policy.packed.sizes,
            numbers=policy.packed.numbers,
            disturbance=most,
            share=float(tolerances.cost),
            floor=float(tolerances.floor),
            violation=float(tolerances.violation),
            patience=tolerances.patience,
            noise=float(tolerances.noise * tolerances.floor) / policy.horizon,
            steps=int(np.isfinite(tolerances.step).any()),
            step=np.broadcast_to(np.array(tolerances.step, dtype=float), (policy.inputs,)).copy(),
            flat=flat,
            **{name: np.zeros(plan) for name in ("inputs", "kept_inputs")},
            **{name: np.zeros(path) for name in ("states", "kept_states")},
            cost=np.full(1, math.inf),
            kept_disturbance=np.zeros(policy.inputs),
            course=np.zeros(1, SUPERVISION),
        )
        self._course = self.compiled.course
        self.layers: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.reason = WAITING
        """Result of the last check."""
        call_supervised(self.compiled, self.instance, NOTHING, 0)  # compiled now, not when it is first needed
        end_supervised(self.compiled, self.instance)
        self.reset()

    def reset(self) -> None:
        """Forget the last plan; counts stay."""
        forget_supervised(self.compiled)
        self.policy.reset()

    def prepare(self, elapsed: float) -> None:
        """Shift the last plan by the time until the next call [s]; where the network drives with steps, the exact MPC
        makes that plan first.
        """
        course = self._course
        course["unplanned"] += elapsed
        if course["unsolved"][0]:
            course["unsolved"] = 0
            self.mpc.within_time(self.instance, partial(self._call, SOLVE))
        self.mpc.prepare(elapsed)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`."""
        instance, mpc = self.instance, self.mpc
        instance.assign(state, disturbance, previous_input, preview)
        status = mpc.within_time(instance, partial(self._call, ANSWER))
        if status is not Status.POLICY:
            ended = STATUSES[end_supervised(self.compiled, instance)]
            status = ended if ended is Status.HELD else status
        reason = self.reason = int(self._course["reason"][0])
        self.layers[LAYERS[status]] += 1
        self.reasons[REASONS[reason]] += 1
        plan = mpc.planned(status)
        if status is Status.POLICY:
            plan = plan._replace(states=self.compiled.states[1:].copy())
        return plan

    def _call(self, purpose: int, iterations: int, anew: bool) -> int:
        """A call of compiled code; see :meth:`~hybrid_sysid_ros.control.mpc.mpc.ExactMpc.within_time`."""
        found: int = call_supervised(self.compiled, self.instance, purpose if anew else GO_ON, iterations)
        return found


# ---------------------------------------------------------------------- in compiled code

ANSWER, SOLVE, GO_ON, NOTHING = range(4)
"""What a call is for: an answer to an instance, the exact MPC's own one, more steps of that, and compiling alone."""


@kernel
def forget_supervised(own: SupervisorMemory) -> None:
    """:func:`begin_supervision` for Python."""
    begin_supervision(own)


@kernel
def call_supervised(own: SupervisorMemory, instance: Instance, purpose: int, iterations: int) -> int:
    """:func:`accept` for Python, and where it does not, a call of the exact MPC, or that call first; the status.

    One function for all purposes, since the solver takes longest to compile.
    """
    first = purpose == ANSWER and own.steps != 0 and own.mpc.real_time != 0
    if purpose != NOTHING and (first or purpose != ANSWER or not accept(own, instance)):
        solve_within(own.mpc, instance, iterations, purpose != GO_ON)
        if first:
            accept_beside_step(own, instance)
    return own.mpc.call[0].status  # type: ignore[no-any-return]


@kernel
def end_supervised(own: SupervisorMemory, instance: Instance) -> int:
    """:func:`fall_back` for Python; the status."""
    fall_back(own, instance)
    return own.mpc.call[0].status  # type: ignore[no-any-return]
