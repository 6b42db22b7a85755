"""The online check: whether a network's plan may drive the rig.

Source: Hose, Köhler, Zeilinger, Trimpe (2025), Approximate nonlinear model predictive control with safety-augmented
neural networks, IEEE TCST 33(6), algorithm 1; there the cost must fall, here it may rise within a stated tolerance, for
the reference and the disturbance move and a network is never exact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, Prediction
from hybrid_sysid_ros.control.mpc.shooting import follow
from hybrid_sysid_ros.control.policy.kernels import Packed, answer, inside
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.support.arrays import Array

Values = tuple[float, ...]

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
"""By how much an input may be outside of its bounds [its unit]."""


class Tolerances(NamedTuple):
    """Within which a plan is accepted."""

    cost: float
    """Share by which a plan may be costlier than the shifted one."""
    floor: float
    """And by how much at any rate, in the unit of the cost."""
    violation: float
    """By how much a state may be outside of its bounds [its unit]."""
    disturbance: Values
    """(m,), largest input disturbance, or one for all inputs."""
    patience: int
    """Instances in a row that the network must answer well after a rejection, before it drives again."""


@kernel
def check(
    policy: Packed,
    prediction: Prediction,
    horizon: Horizon,
    instance: Instance,
    flat: Array,
    limits: tuple[Array, float, float, float],
    inputs: Array,
    states: Array,
) -> int:
    """What a policy's plan is found to be, beside the shifted one in the horizon of an exact MPC; the plan and where it
    leads are then in ``inputs`` and ``states``. limits: of disturbance, share and floor of the cost, violation.

    It is accepted where the instance is one like those of the training and the disturbance is not too large, the plan's
    simulation is finite, keeps the bounds of inputs, of their changes and, within the tolerance, of states, and it is
    not costlier. How far outside the shifted plan leads excuses nothing: plan after plan could be a little further out
    than the one before, and where a push has put that one out, the exact MPC may well find one that is not.
    """
    sizes, numbers = policy
    disturbance, share, floor, violation = limits
    if not answer(sizes, numbers, flat, inputs):
        return OUT_OF_RANGE
    for j in range(disturbance.shape[0]):
        if not abs(instance.disturbance[j]) <= disturbance[j]:
            return DISTURBED
    if not inside(sizes, numbers, flat):
        return OUT_OF_RANGE
    if not _bounded(instance, horizon, inputs):
        return INFEASIBLE
    weights = horizon.weights
    shifted_cost, _ = follow(prediction, weights, instance, horizon.inputs, states)
    cost, outside = follow(prediction, weights, instance, inputs, states)
    if not math.isfinite(cost) or outside > violation:
        return INFEASIBLE
    if not math.isfinite(shifted_cost):
        return ACCEPTED
    return COSTLIER if cost > (1.0 + share) * shifted_cost + floor else ACCEPTED


@inner
def _bounded(instance: Instance, horizon: Horizon, inputs: Array) -> bool:
    """Whether inputs and their changes are within their bounds."""
    for j in range(inputs.shape[1]):
        low, high = horizon.limits.low[j], horizon.limits.high[j]
        before = min(max(instance.previous[j], low), high)
        for i in range(inputs.shape[0]):
            u = inputs[i, j]
            if not (low - ROUNDING <= u <= high + ROUNDING and abs(u - before) <= horizon.limits.rate[j] + ROUNDING):
                return False
            before = u
    return True
