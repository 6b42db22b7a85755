"""What an estimator tells, and the counters of what it met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """time: stamp of the measurement [s]. state (states,) at that time; ahead (states,): the state that the next
    command will meet, a delay later. disturbance (inputs,): offset of the input [drive unit]. covariance (augmented,
    augmented) of [state, disturbance, hum]. innovation (outputs,) and its normalised square, NaN without a valid
    measurement.
    """

    time: float
    state: Array
    ahead: Array
    disturbance: Array
    covariance: Array
    innovation: Array
    normalised_innovation: float


@dataclass(kw_only=True)
class Counters:
    """updates: measurements used. late: stamps not after the last one, ignored. missing: measurements that a gap in the
    stamps swallowed. invalid: NaN or infinite entries, not used. gated: outliers by the innovation test, not used.
    resets: returns to the measurement after a run of outliers or a long gap.
    """

    updates: int = 0
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

    def reset(self) -> None:
        """Forget everything; the next measurement starts afresh."""
        ...
