"""What an estimator tells, and the counters of what it met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """time: of the newest measurement [s]. state (states,) at that time; ahead (states,): the state that the next
    command will meet, a delay later. disturbance (inputs,): offset of the input [drive unit] with which the equation as
    it was given fits best. parameters (followed,): the followed ones, in the tuning's order. covariance (augmented,
    augmented) of [state, disturbance, hum, parameters]. innovation (outputs,) of the measurement just given and its
    normalised square, NaN without a valid one.
    """

    time: float
    state: Array
    ahead: Array
    disturbance: Array
    parameters: Array
    covariance: Array
    innovation: Array
    normalised_innovation: float


@dataclass(kw_only=True)
class Counters:
    """updates: measurements used. delayed: those of them that were older than the newest and were put in their place.
    late: stamps too old for that, or repeated; ignored. missing: measurements that a gap in the stamps swallowed.
    invalid: NaN or infinite entries, not used. gated: outliers by the innovation test, not used. resets: returns to the
    measurement after a run of outliers or a long gap.
    """

    updates: int = 0
    delayed: int = 0
    late: int = 0
    missing: int = 0
    invalid: int = 0
    gated: int = 0
    resets: int = 0


class Estimator(Protocol):
    """One interface for every estimator."""

    counters: Counters

    def update(self, time: float, output: Array, applied: Array) -> Estimate:
        """A measurement (outputs,) stamped ``time`` [s], and the mean input (inputs,) since the one before."""
        ...

    def correct(self, time: float, value: float, channel: str) -> Estimate:
        """A measurement of one of the tuning's further channels, stamped ``time`` [s], in any order."""
        ...

    def reset(self) -> None:
        """Forget everything; the next measurement starts afresh."""
        ...
