"""Inputs of a plan within their limits."""

from __future__ import annotations

import math

from hybrid_sysid_ros.control.mpc.horizon import Horizon
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array


@inner
def clamp_inputs(horizon: Horizon, previous: Array, inputs: Array, blocked: bool) -> None:
    """Limit inputs (N, m) to their bounds and rate limits after ``previous`` (m,); the last value replaces NaN.

    blocked: whether to hold them through each block, too.
    """
    limits = horizon.limits
    for j in range(inputs.shape[1]):
        before = previous[j]
        before = min(max(before, limits.low[j]), limits.high[j]) if math.isfinite(before) else math.nan
        for i in range(inputs.shape[0]):
            held = blocked and i > 0 and limits.moves[i] == limits.moves[i - 1]
            u = before if held else inputs[i, j]
            if not math.isfinite(u):
                u = before if math.isfinite(before) else 0.0
            if math.isfinite(before):
                u = min(max(u, before - limits.rate[j]), before + limits.rate[j])
            before = min(max(u, limits.low[j]), limits.high[j])
            inputs[i, j] = before
