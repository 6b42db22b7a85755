"""The cost of a stage, written once: for the MPC, the checks of its imitations, certificates and whole loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array

if TYPE_CHECKING:
    from hybrid_sysid_ros.control.problem import Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class StageWeights(Shared):
    """What stages cost: n states, m inputs, p outputs."""

    outputs: Array
    """(stages, p) of squared errors [1/unit^2]."""
    rates: Array
    """(stages, m) of squared changes."""
    inputs: Array
    """(stages, m) of squared inputs."""
    low: Array
    """(n,) of the states, -inf: none."""
    high: Array
    """(n,)."""
    linear: Array
    """(n,), price of a state outside by s: linear s + quadratic s^2."""
    quadratic: Array
    """(n,)."""


@inner
def stage_cost(weights: Any, i: int, y: Any, q: Any, u: Any, before: Any, x: Any) -> float:
    """Cost of stage i: outputs y (p,) that should be q (p,) and states x (n,), both at its end, under inputs u (m,)
    after the inputs ``before`` (m,).
    """
    cost = 0.0
    for k in range(y.shape[0]):
        error = y[k] - q[k]
        cost += weights.outputs[i, k] * error * error
    for j in range(u.shape[0]):
        change = u[j] - before[j]
        cost += weights.rates[i, j] * change * change + weights.inputs[i, j] * u[j] * u[j]
    for a in range(x.shape[0]):
        s = excess(weights, a, x[a])
        cost += (weights.linear[a] + weights.quadratic[a] * s) * s
    return cost


@inner
def excess(weights: Any, a: int, value: float) -> float:
    """By how much state a is outside of its bounds."""
    return max(value - weights.high[a], weights.low[a] - value, 0.0)


@kernel
def _stage_costs(
    weights: StageWeights, outputs: Array, references: Array, inputs: Array, previous: Array, states: Array, out: Array
) -> None:
    for k in range(out.shape[0]):
        before = previous if k == 0 else inputs[k - 1]
        out[k] = stage_cost(weights, 0, outputs[k], references[k], inputs[k], before, states[k])


def stage_costs(
    problem: Problem, *, outputs: Array, references: Array, inputs: Array, previous: Array, states: Array
) -> Array:
    """Cost (samples,) of each stage of a loop as it went.

    outputs and references (samples, p), inputs (samples, m), states (samples, n): each row one stage, see
    :func:`stage_cost`. previous (m,): the inputs before the first row. The problem is sized.
    """
    rows = [np.ascontiguousarray(part, dtype=float) for part in (outputs, references, inputs, previous, states)]
    costs = np.empty(len(rows[0]))
    _stage_costs(problem.stage_weights, *rows, costs)
    return costs
