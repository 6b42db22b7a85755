"""Reference governor: leads a reference from where the rig is to where it should be, at a stated rate.

g+ = clip(r, g - rate dt, g + rate dt); the preview is clip(r(t), g - rate t, g + rate t), t from now on. Free, it lets
references pass as they are. Source of the idea: Garone, Di Cairano, Kolmanovsky (2017), Reference and command
governors, Automatica. The kernels are Python, and are printed as C.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.support.arrays import Floats


@dataclass(slots=True)
class ReferenceGovernor:
    """free: it is not from :func:`lead_from` on, until it has met the reference. slow: whether the loop was slowed."""

    free: bool = True
    slow: bool = False


@dataclass(slots=True)
class GovernedOutput:
    """An output under a governor. rate: by which its reference may move [output unit/s]. low, high: lowest and highest
    set-point, NaN where there is none. reference: g.
    """

    rate: float
    low: float
    high: float
    reference: float = 0.0


def lead_from(governor: ReferenceGovernor, outputs: Sequence[GovernedOutput], begin: Floats) -> None:
    """Lead the reference on from here (p,)."""
    governor.free = False
    for k in range(len(outputs)):
        outputs[k].reference = begin[k]


def come_back(governor: ReferenceGovernor, outputs: Sequence[GovernedOutput], begin: Floats) -> None:
    """Lead the reference on from here (p,), or from the nearest set-points. A rig that is beyond all of these has been
    driven there, and is brought back as fast as it may.
    """
    governor.free = False
    for k in range(len(outputs)):
        if math.isfinite(begin[k]):
            outputs[k].reference = min(max(begin[k], outputs[k].low), outputs[k].high)


def follow_state(
    governor: ReferenceGovernor, outputs: Sequence[GovernedOutput], slow: bool, now: Floats, found: Floats
) -> None:
    """Lead the reference on from where it is now (p,) where a loop is slowed, and from where the rig is found (p,), NaN
    where that is unknown, once it is slowed no more.
    """
    if slow and governor.free:
        lead_from(governor, outputs, now)
    if governor.slow and not slow:
        come_back(governor, outputs, found)
    governor.slow = slow


def follow_reference(
    governor: ReferenceGovernor, outputs: Sequence[GovernedOutput], now: Floats, preview: Floats,
    times: Floats, share: float, elapsed: float, keep: bool,
) -> None:  # fmt: skip
    """Govern a preview (points p,) in place, one point after another. now: the reference at this moment (p,). times
    (points,): of the preview, from now on [s]. share: of the rates. keep: go on to govern where it has met the
    reference.
    """
    p, met = len(outputs), True
    for k in range(p):
        rate, g = share * outputs[k].rate, outputs[k].reference
        g = min(max(now[k], g - rate * elapsed), g + rate * elapsed)
        outputs[k].reference = g
        met = met and g == now[k]
        for i in range(len(times)):
            reach = times[i] * rate
            preview[i * p + k] = min(max(preview[i * p + k], g - reach), g + reach)
    governor.free = met and not keep
