"""Accuracy: systematic error, dispersion, correlation and circular error probable, with intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hybrid_sysid_ros.extensions.accuracy.statistics.assumptions import Assumptions, assumptions
from hybrid_sysid_ros.extensions.accuracy.statistics.circular_error import circular_error_probable
from hybrid_sysid_ros.extensions.accuracy.statistics.discrepancy import Conflict, Discrepancy, conflict
from hybrid_sysid_ros.extensions.accuracy.statistics.normal_inverse_wishart import NormalInverseWishart
from hybrid_sysid_ros.extensions.accuracy.statistics.shots import Shots
from hybrid_sysid_ros.support.errors import UserError

DRAWS = 20_000
"""Of the covariance, for what has no closed form."""
FEWEST = 3
"""Live shots: two have no spread to speak of."""
MOST = 8
"""Coordinates for which the coverage was measured."""
SIMULATED = 50
"""Simulated shots for which it was, where their spread may be off."""
CONTRADICTED = 0.05
"""p-value below which live shots contradict what was declared of their simulation."""
LEVELS = 0.01, 0.999
"""Of intervals; further out DRAWS tell nothing."""
UNIT_LIKE = 20.0
"""Ratio of spreads that is rather a mixed-up unit."""


@dataclass(frozen=True, kw_only=True)
class Bounded:
    """A number with its interval."""

    low: float
    value: float
    high: float

    @property
    def width(self) -> float:
        return self.high - self.low


@dataclass(frozen=True, kw_only=True)
class AccuracyEstimate:
    """What is known of the accuracy."""

    posterior: NormalInverseWishart
    mean: tuple[Bounded, ...]
    """Systematic error of each coordinate."""
    spread: tuple[Bounded, ...]
    """Standard deviation of each coordinate."""
    correlation: dict[tuple[int, int], Bounded]
    """Of each two coordinates."""
    circular_error: Bounded | None
    """Circular error probable about the mean point of impact; None unless there are two coordinates of one unit."""


def estimate(
    posterior: NormalInverseWishart, level: float, generator: np.random.Generator, *, circle: bool, alone: bool = False
) -> AccuracyEstimate:
    """Medians and central intervals of probability ``level``; the last two from DRAWS draws of the covariance.

    circle: whether to tell the circular error probable, which needs two coordinates of one unit. alone: whether the
    posterior is of shots alone.
    """
    tails = [0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level]

    def bounded(low: float, value: float, high: float) -> Bounded:
        return Bounded(low=float(low), value=float(value), high=float(high))

    d = posterior.coordinates
    marginal = posterior.of_each_alone if alone else posterior
    means, spreads = marginal.mean_interval(level), marginal.spread_interval(level)
    drawn = posterior.covariances(DRAWS, generator) if d > 1 else np.empty((0, 1, 1))
    pairs = {(i, j): drawn[:, i, j] / np.sqrt(drawn[:, i, i] * drawn[:, j, j]) for i, j in combinations(range(d), 2)}
    return AccuracyEstimate(
        posterior=posterior,
        mean=tuple(map(bounded, means[0], posterior.centre, means[1])),
        spread=tuple(map(bounded, spreads[0], marginal.spread(), spreads[1])),
        correlation={pair: bounded(*np.quantile(values, tails)) for pair, values in pairs.items()},
        circular_error=bounded(*np.quantile(circular_error_probable(drawn), tails)) if circle else None,
    )


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """What simulated and live shots tell together, and each alone."""

    live: Shots
    simulated: Shots
    discrepancy: Discrepancy
    level: float
    prior: NormalInverseWishart
    joint: AccuracyEstimate
    live_only: AccuracyEstimate
    simulated_only: AccuracyEstimate
    conflict: Conflict
    assumptions: tuple[Assumptions, Assumptions]
    """Of the live and of the simulated shots."""

    @property
    def doubts(self) -> list[str]:
        """What speaks against the assumptions, a sentence each."""
        return [sentence for part in self.assumptions for sentence in part.sentences]

    @property
    def contradictions(self) -> list[str]:
        """What of the simulation the live shots contradict, a sentence each."""
        found, names = [], self.live.names
        if self.conflict.mean < CONTRADICTED:
            k = int(np.argmax(np.abs(self.conflict.offset)))
            found.append(
                f"the live mean contradicts the simulation (p {self.conflict.mean:.2g}; {names[k]} is off by "
                f"{self.conflict.offset[k]:+.2g} standard deviations, declared was {self.discrepancy.mean:g})"
            )
        if self.conflict.spread < CONTRADICTED:
            k = int(np.argmax(np.abs(np.log(self.conflict.ratio))))
            found.append(
                f"the live spread contradicts the simulation (p {self.conflict.spread:.2g}; that of {names[k]} is "
                f"{self.conflict.ratio[k]:.2g} times the simulated one, declared was a factor of "
                f"{math.exp(self.discrepancy.spread):.3g})"
            )
        return found

    @property
    def cure(self) -> str:
        """What to do about these; spreads that differ by UNIT_LIKE are rather two units."""
        if np.max(np.abs(np.log(self.conflict.ratio))) > math.log(UNIT_LIKE):
            return "check that both files have the same units"
        return "look for the cause, or take what the live shots say alone; what they show is no reason to declare more"


def fewest(coordinates: int) -> int:
    """Shots that so many coordinates need at least."""
    return max(FEWEST, coordinates + 1)


def assess(simulated: Shots, live: Shots, discrepancy: Discrepancy, *, level: float = 0.9, seed: int = 0) -> Accuracy:
    """Accuracy from simulated and live shots of the same coordinates.

    Raises UserError where coordinates or units differ, live shots are too few or the simulated ones, a coordinate
    follows from others, or the level is none.
    """
    if not LEVELS[0] <= level <= LEVELS[1]:
        raise UserError(f"level {level:g}: needs a probability from {LEVELS[0]:g} to {LEVELS[1]:g}, such as 0.9")
    live = live.as_those_of(simulated)
    if np.array_equal(live.values, simulated.values):
        raise UserError(f"{live.name}: has the very numbers of {simulated.name}: give the live shots second")
    d = len(live.names)
    if d > MOST:
        raise UserError(f"{live.name}: has {d} coordinates, more than {MOST}: take those that matter")
    least = fewest(d)
    for shots in (simulated, live):
        if len(shots.values) < least:
            raise UserError(
                f"{shots.name}: {len(shots.values)} shots: {d} coordinates need {least} at least; fire or simulate more"
            )
        shots.check_spread()
    if discrepancy.spread and len(simulated.values) < SIMULATED:
        raise UserError(
            f"{simulated.name}: {len(simulated.values)} shots: a spread that may be off needs {SIMULATED} simulated "
            "ones at least; simulate more"
        )
    nothing = NormalInverseWishart.reference(d)
    known = nothing.updated(simulated.values)
    prior = discrepancy.weaken(known)
    generator = np.random.default_rng(seed)
    circle = d == 2 and len({*live.units}) == 1

    def summary(posterior: NormalInverseWishart, *, alone: bool = False) -> AccuracyEstimate:
        return estimate(posterior, level, generator, circle=circle, alone=alone)

    return Accuracy(
        live=live,
        simulated=simulated,
        discrepancy=discrepancy,
        level=level,
        prior=prior,
        joint=summary(prior.updated(live.values)),
        live_only=summary(nothing.updated(live.values), alone=True),
        simulated_only=summary(known, alone=True),
        conflict=conflict(prior, live.values, generator, simulated=simulated.values.std(axis=0, ddof=1)),
        assumptions=(assumptions(live, generator), assumptions(simulated, generator)),
    )
