"""How far a simulation may be off, said beforehand, and whether live shots contradict it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import brentq
from scipy.special import digamma

from hybrid_sysid_ros.extensions.accuracy.statistics.normal_inverse_wishart import NormalInverseWishart
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

DRAWS = 20_000
"""Of the statistic under agreement: a p-value of .05 is then known to .0015."""
WIDEST = 0.35
"""Discrepancy of the spread up to which 90 % intervals were found to hold the truth in 88 to 92 %."""


@dataclass(frozen=True, kw_only=True)
class Discrepancy:
    """What one is ready to believe about a simulator, one standard deviation each. Separate for mean and spread: a
    simulator is often right about the spread and wrong about the mean. Raises UserError for negative ones.
    """

    mean: float
    """tau_b: its mean is off by so many standard deviations of the shots; infinite where it says nothing of it."""
    spread: float
    """tau_s: its standard deviations are off by a factor of exp(tau_s), .1 for some 10 %; WIDEST at most."""

    def __post_init__(self) -> None:
        if not self.mean >= 0.0:
            raise UserError(f"a discrepancy of the mean of {self.mean:g}: it needs 0 or more standard deviations")
        if not 0.0 <= self.spread <= WIDEST:
            raise UserError(
                f"a discrepancy of the spread of {self.spread:g}: it needs a number from 0 to {WIDEST:g}, for beyond "
                "it no interval was found to hold its level; take what the live shots say alone"
            )

    def weaken(self, simulated: NormalInverseWishart) -> NormalInverseWishart:
        """What simulated shots tell of live ones: the prior of these.

        The declared prior, live sigma = exp(t) simulated sigma with t ~ N(0, tau_s^2), is no inverse Wishart. The
        nearest one by the divergence of Kullback and Leibler has its means of log sigma^2 and of 1 / sigma^2. With f0
        marginal degrees of freedom, L(x) = log x - digamma(x) and S0 the scatter matrix of the n0 simulated shots:

            L(f0 / 2) = L((n0 - 1) / 2) + 2 tau_s^2,   nu0 = f0 + d - 1
            Psi0 = S0 exp(-2 tau_s^2) f0 / (n0 - 1),   k0 = 1 / (1 / n0 + tau_b^2)
        """
        free, wider = simulated.of_each_alone.marginal_degrees, 2.0 * self.spread**2
        weaker = _degrees(_excess(free) + wider) if wider else free
        return NormalInverseWishart(
            centre=simulated.centre,
            strength=1.0 / (1.0 / simulated.strength + self.mean * self.mean),
            scale=simulated.scale * (math.exp(-wider) * weaker / free),
            degrees=weaker + simulated.coordinates - 1,
        )


def _excess(degrees: float) -> float:
    """log(f / 2) - digamma(f / 2), which falls with the degrees of freedom f."""
    return math.log(0.5 * degrees) - float(digamma(0.5 * degrees))


def _degrees(excess: float) -> float:
    """The degrees of freedom of an excess, which lies between 1 / f and 2 / f."""
    return float(brentq(lambda degrees: _excess(degrees) - excess, 1.0 / excess, 2.0 / excess))


@dataclass(frozen=True, kw_only=True)
class Conflict:
    """How live shots differ from simulated ones, and how probable so much is under what was declared."""

    offset: Array
    """Live less simulated mean, in simulated standard deviations, (d,)."""
    ratio: Array
    """Live over simulated standard deviation, (d,)."""
    mean: float
    """p-value of the means; not a number where nothing is believed of the simulated one."""
    spread: float
    """p-value of the covariances."""


def conflict(prior: NormalInverseWishart, live: Array, generator: np.random.Generator, *, simulated: Array) -> Conflict:
    """Compare live shots (n, d) with their prior. Both tests are exact under the prior predictive distribution (Box
    1980, J. R. Stat. Soc. A 143); without a declared discrepancy they are the two-sample tests of Hotelling and Box.

    simulated: standard deviations (d,).

    With W = Psi0 + S, f = f0 + n - d:  (y - m0)' W^-1 (y - m0) f / (d (1/k0 + 1/n)) ~ F(d, f).
    The covariances by Box's M of Psi0 and S, whose distribution is drawn, two-sided.
    """
    count, d = live.shape
    own = NormalInverseWishart.reference(d).updated(live)
    offset, free = own.centre - prior.centre, prior.marginal_degrees + count - d
    squares = float(offset @ np.linalg.solve(prior.scale + own.scale, offset))
    shots = prior.strength * count / (prior.strength + count)
    return Conflict(
        offset=offset / simulated,
        ratio=np.sqrt(np.diagonal(own.scale) / own.degrees) / simulated,
        mean=float(stats.f.sf(shots * squares * free / d, d, free)) if shots else math.nan,
        spread=_covariance_test(prior, own, generator),
    )


def _covariance_test(prior: NormalInverseWishart, own: NormalInverseWishart, generator: np.random.Generator) -> float:
    first, second, d = prior.degrees, own.degrees, own.coordinates

    def statistic(one: Array, other: Array) -> Array:
        """Box's M of sums of squares (..., d, d) with ``first`` and ``second`` degrees of freedom."""
        both = first + second
        logarithms = (np.linalg.slogdet(matrix)[1] for matrix in ((one + other) / both, one / first, other / second))
        return np.asarray(np.array([both, -first, -second]) @ np.array([*logarithms]))

    drawn = (
        np.reshape(stats.wishart(degrees, np.eye(d)).rvs(DRAWS, random_state=generator), (DRAWS, d, d))
        for degrees in (first, second)
    )
    larger = np.sum(statistic(*drawn) >= statistic(prior.scale, own.scale))
    return float((1 + larger) / (1 + DRAWS))
