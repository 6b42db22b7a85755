"""What a closed loop must keep, and how it is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.safety.certificate import ALL
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.structured import numbers

DRIVERS = EXACT, NETWORK, SUPERVISED = range(3)
JUDGED = {"network": NETWORK, "supervised": SUPERVISED}
MEASURES = COST, ERROR, WORST_PERIOD, UNSOLVED, EXCESS, TRAVEL, VALIDITY, TRACKING = range(8)
"""Of a driver's loop: its cost as it went; the largest difference of an input from the exact MPC's answer to the same
instance, in shares of the input error that is allowed, and the period in which it was; periods in which that answer is
none or not converged; by how much a state was outside of its soft bounds, of the travel, and of the validity; and the
largest tracking error in the last quarter beyond that of the exact MPC's own loop, in shares of what is allowed. An
input outside of its bounds or a state that is no number makes EXCESS infinite."""

SETTLED = 0.75
"""Share of a loop after which its tracking must have settled."""

ROUNDING = 1e-9
"""By how much a state may be beyond its travel or its validity [its unit]."""


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """What a loop must keep. n states, m inputs, p outputs."""

    input_error: Numbers
    """eta (m,): by how much an input may be off the exact MPC's [its unit]."""
    cost_share: float
    """By how much its cost may be above that of the exact MPC's own loop."""
    cost_floor: float
    """And by how much at any rate, for each period."""
    tracking_error: Numbers
    """(p,): by how much a tracked output may be further off its reference than in the exact MPC's own loop, in the last
    quarter [its SI unit]."""
    travel: tuple[Numbers, Numbers] | None = None
    """Lowest and highest value of each state (n,), where the rig has such."""
    validity: tuple[Numbers, Numbers] | None = None
    """The same, within which the rig's equations mean something."""

    def sized(self, model: System) -> Criteria:
        """With a value for each input and output. Raises UserError where it has another number of them."""
        m, p = len(model.inputs), len(model.outputs)
        return replace(
            self,
            input_error=numbers(self.input_error, "certificate: input_error", count=m),
            tracking_error=numbers(self.tracking_error, "certificate: tracking_error", count=p),
        )

    def outside(self, states: Array) -> tuple[float, float]:
        """By how much states (T, n) are outside of travel and validity at most; infinite where one is no number."""
        return _outside(states, self.travel), _outside(states, self.validity)

    def kept(self, measures: Array, periods: int, violation: float) -> dict[str, dict[str, NDArray[np.bool_]]]:
        """Which loops keep each criterion, by driver; measures (loops, drivers, measures).

        input: within eta of the exact MPC's at every period. bounds: inputs within theirs, and states no further out of
        their soft bounds than in the exact MPC's own loop, but for ``violation``. cost: near that of the exact MPC's
        own loop. settled: so is the tracking in the end. travel, validity: kept, where the rig has such.
        """
        exact = measures[:, EXACT]
        allowed = (1.0 + self.cost_share) * exact[:, COST] + self.cost_floor * periods
        found = {}
        for name, driver in JUDGED.items():
            rows = measures[:, driver]
            parts = {
                "input": rows[:, ERROR] <= 1.0,
                "bounds": rows[:, EXCESS] <= exact[:, EXCESS] + violation,
                "cost": rows[:, COST] <= allowed,
                "settled": rows[:, TRACKING] <= 1.0,
            }
            if self.travel is not None:
                parts["travel"] = rows[:, TRAVEL] <= ROUNDING
            if self.validity is not None:
                parts["validity"] = rows[:, VALIDITY] <= ROUNDING
            found[name] = {**parts, ALL: np.logical_and.reduce(list(parts.values()))}
        return found


def _outside(states: Array, limits: tuple[Numbers, Numbers] | None) -> float:
    if limits is None:
        return 0.0
    low, high = (np.array(part) for part in limits)
    beyond = float(np.max(np.maximum(low - states, states - high), initial=0.0))
    return beyond if np.isfinite(states).all() else np.inf
