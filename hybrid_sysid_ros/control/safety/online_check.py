"""The online check: whether a network's plan may drive the rig, in compiled code.

Source: Hose, Köhler, Zeilinger, Trimpe (2025), Approximate nonlinear model predictive control with safety-augmented
neural networks, IEEE TCST 33(6), algorithm 1; there the cost must fall, here it may rise within a stated tolerance, for
the reference and the disturbance move and a network is never exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.horizon import instance_of
from hybrid_sysid_ros.control.mpc.shooting import rollout
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

ACCEPTED, OUT_OF_RANGE, DISTURBED, INFEASIBLE, COSTLIER, WAITING = range(6)
REASONS = (
    "accepted",
    "out of range",
    "disturbance too large",
    "not feasible",
    "costlier than the shifted plan",
    "waiting for good answers",
)
"""What a check found; waiting: at the beginning, when there is no last plan to compare with, and after a rejection."""

ROUNDING = 1e-9
"""By how much an input may be outside of its bounds [drive unit]."""


class Tolerances(NamedTuple):
    """cost: share by which a plan may be costlier than the shifted one; floor: and by how much at any rate, in the unit
    of the cost. violation: by how much further a state may be outside of its bounds [its unit]. disturbance: largest
    input disturbance [drive unit]. patience: questions in a row that the network must answer well after a rejection,
    before it drives again.
    """

    cost: float
    floor: float
    violation: float
    disturbance: float
    patience: int


class Trial(NamedTuple):
    """What a check works on: the network's inputs (horizon, 1), the states they lead to (horizon + 1, states) and how
    many questions it has still to wait for, (1,).
    """

    inputs: Array
    states: Array
    waiting: NDArray[np.int64]


def trial(policy: Policy) -> Trial:
    """Memory for the plans of a policy. Raises UserError for one that gives its first input alone."""
    if policy.outputs != policy.horizon:
        raise UserError(
            f"policy: gives {policy.outputs} of the {policy.horizon} inputs of a plan, so that it can't be checked or "
            "certified; train it to give the whole sequence, or use it alone and uncertified (policy:=network)"
        )
    states = np.zeros((policy.horizon + 1, policy.states))
    return Trial(np.zeros((policy.horizon, 1)), states, np.zeros(1, np.int64))


@dataclass(frozen=True, kw_only=True)
class OnlineCheck:
    """Compiled functions. question: [x, d, u_previous, q_1..q_N]; model, horizon: of the exact MPC's
    :class:`~.shooting.Shooting`, whose inputs are the shifted last plan.

    check(question, memory, training_range, model, horizon, tolerances, trial): one of the reasons above; memory,
    training_range: of the policy. ``trial`` receives the network's plan. A plan is accepted where the question is one
    like those of the training and the disturbance is not too large, the plan's simulation is finite and keeps the
    bounds of inputs and their changes, the states are outside of their bounds by no more than those of the shifted
    plan, and it is not costlier.
    follow(question, model, horizon, inputs, states): simulates inputs (horizon,) into ``states`` (horizon + 1, states);
    their cost, and how far a state is outside of its bounds.
    """

    check: Callable[..., int]
    follow: Callable[..., tuple[float, float]]


_COMPILED: dict[tuple[Any, ...], OnlineCheck] = {}


def online_check(system: System, policy: Policy) -> OnlineCheck:
    """The check of a policy by its model's equation, compiled once in a process for each form of them."""
    key = (*system.form, policy.kernels)
    if key not in _COMPILED:
        _COMPILED[key] = _compile(system, policy)
    return _COMPILED[key]


def _compile(system: System, policy: Policy) -> OnlineCheck:
    answer, inside = policy.kernels.answer, policy.kernels.inside
    count = len(system.states)
    offset, previous_input = count, count + 1

    @inner
    def follow(question: Array, model: Any, horizon: Any, inputs: Array, states: Array) -> tuple[float, float]:
        return rollout(model, horizon.weights, instance_of(question, count, 1, 1), inputs, states)  # type: ignore[no-any-return]

    @inner
    def bounded(question: Array, horizon: Any, inputs: Array) -> bool:
        """Whether inputs and their changes are within their bounds."""
        limit = horizon.high[0]
        before = min(max(question[previous_input], -limit), limit)
        for i in range(inputs.shape[0]):
            u = inputs[i, 0]
            if not (abs(u) <= limit + ROUNDING and abs(u - before) <= horizon.rate[0] + ROUNDING):
                return False
            before = u
        return True

    @inner
    def judge(
        question: Array, memory: Array, training_range: Array, model: Any, horizon: Any, tolerances: Any, trial: Any
    ) -> int:
        if not answer(question, memory, trial.inputs):
            return OUT_OF_RANGE
        if not abs(question[offset]) <= tolerances.disturbance:
            return DISTURBED
        if not inside(question, memory, training_range):
            return OUT_OF_RANGE
        if not bounded(question, horizon, trial.inputs):
            return INFEASIBLE
        shifted_cost, shifted_outside = follow(question, model, horizon, horizon.inputs, trial.states)
        cost, outside = follow(question, model, horizon, trial.inputs, trial.states)
        if not np.isfinite(cost):
            return INFEASIBLE
        if not np.isfinite(shifted_cost):
            return ACCEPTED
        if outside > shifted_outside + tolerances.violation:
            return INFEASIBLE
        if cost > (1.0 + tolerances.cost) * shifted_cost + tolerances.floor:
            return COSTLIER
        return ACCEPTED

    def check(
        question: Array, memory: Array, training_range: Array, model: Any, horizon: Any, tolerances: Any, trial: Any
    ) -> int:
        reason = judge(question, memory, training_range, model, horizon, tolerances, trial)
        if reason != ACCEPTED:
            trial.waiting[0] = tolerances.patience
        elif trial.waiting[0] > 0:
            trial.waiting[0] -= 1
            return WAITING
        return reason  # type: ignore[no-any-return]

    return OnlineCheck(check=numba.njit(check, **OPTIONS), follow=follow)
