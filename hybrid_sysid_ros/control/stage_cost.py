"""The cost of a stage, which is written once.

The MPC, checks of its imitations, certificates and scores of whole loops use the same cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class StageWeights(Shared):
    """Weights of stage costs for n states, m inputs, and r values: p outputs and the terms behind them."""

    outputs: Array
    """Weights of the values' squared errors, (stages, r) [1/unit^2]."""
    prices: Array
    """Prices of the values, (stages, r) [1/unit]."""
    rates: Array
    """Weights of squared changes, (stages, m)."""
    inputs: Array
    """Weights of the inputs' squared distances from ``rest``, (stages, m)."""
    rest: Array
    """(m,)."""
    low: Array
    """Lower bounds of the states, (stages, n); -inf: none."""
    high: Array
    """(stages, n)."""
    linear: Array
    """(n,); a state that is outside by s costs linear s + quadratic s^2."""
    quadratic: Array
    """(n,)."""
    value_low: Array
    """Lower bounds of the values, (stages, r)."""
    value_high: Array
    """(stages, r)."""
    value_linear: Array
    """(r,), as of the states."""
    value_quadratic: Array
    """(r,)."""


@inner
def is_squared(weights: StageWeights) -> bool:
    """Whether values cost their squared errors alone, and have no price."""
    squared = True
    for i in range(weights.prices.shape[0]):
        for k in range(weights.prices.shape[1]):
            squared = squared and weights.prices[i, k] == 0.0
    return squared


@inner
def stage_cost(weights: Any, i: int, y: Any, q: Any, u: Any, before: Any, x: Any) -> float:
    """Cost of stage i with values y (r,), references q (p,) of the outputs and states x (n,) at its end, inputs u (m,)
    and previous inputs ``before`` (m,).
    """
    cost = 0.0
    for k in range(q.shape[0]):
        error = y[k] - q[k]
        cost += weights.outputs[i, k] * error * error
    for j in range(u.shape[0]):
        change, away = u[j] - before[j], u[j] - weights.rest[j]
        cost += weights.rates[i, j] * change * change + weights.inputs[i, j] * away * away
    for a in range(x.shape[0]):
        s = excess(weights, i, a, x[a])
        cost += (weights.linear[a] + weights.quadratic[a] * s) * s
    for k in range(q.shape[0], y.shape[0]):
        s = max(y[k] - weights.value_high[i, k], weights.value_low[i, k] - y[k], 0.0)
        cost += (weights.outputs[i, k] * y[k] + weights.prices[i, k]) * y[k]
        cost += (weights.value_linear[k] + weights.value_quadratic[k] * s) * s
    return cost


@inner
def excess(weights: Any, i: int, a: int, value: float) -> float:
    """Distance of state a from its bounds of stage i, 0 within them."""
    return max(value - weights.high[i, a], weights.low[i, a] - value, 0.0)


@kernel
def _stage_costs(
    weights: StageWeights, outputs: Array, references: Array, inputs: Array, previous: Array, states: Array, out: Array
) -> None:
    for k in range(out.shape[0]):
        before = previous if k == 0 else inputs[k - 1]
        out[k] = stage_cost(weights, 0, outputs[k], references[k], inputs[k], before, states[k])


def stage_costs(
    weights: StageWeights, *, outputs: Array, references: Array, inputs: Array, previous: Array, states: Array
) -> Array:
    """Cost (samples,) of each stage of a loop.

    outputs (samples, p), or with the terms behind them (samples, r), references (samples, p), inputs (samples, m),
    states (samples, n): each row one stage, see :func:`stage_cost`. previous (m,): the inputs before the first row.
    weights: of one stage, of a problem that is sized.
    """
    rows = [np.ascontiguousarray(part, dtype=float) for part in (outputs, references, inputs, previous, states)]
    costs = np.empty(len(rows[0]))
    _stage_costs(weights, *rows, costs)
    return costs
