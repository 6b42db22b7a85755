"""What is known of a normal distribution: of its mean and covariance together, conjugate to samples of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from hybrid_sysid_ros.support.arrays import Array

Interval = tuple[Array, Array]
"""Lower and upper end."""


@dataclass(frozen=True, kw_only=True)
class NormalInverseWishart:
    """Normal-inverse-Wishart distribution (Gelman et al., Bayesian Data Analysis, 3rd ed., section 3.6).

        mean | covariance ~ N(centre, covariance / strength) ;  covariance ~ IW(scale, degrees)

    centre: (..., d). scale: (..., d, d). Leading axes are independent problems with the same number of shots.
    """

    centre: Array
    strength: float
    """kappa: how many shots the knowledge of the mean is worth."""
    scale: Array
    degrees: float
    """nu: how many degrees of freedom the knowledge of the covariance is worth."""

    @classmethod
    def reference(cls, coordinates: int) -> NormalInverseWishart:
        """Nothing known, p ~ |covariance|^(-(d + 1) / 2): shots alone then tell everything."""
        centre, scale = np.zeros(coordinates), np.zeros((coordinates, coordinates))
        return cls(centre=centre, strength=0.0, scale=scale, degrees=-1.0)

    @property
    def of_each_alone(self) -> NormalInverseWishart:
        """Shots alone, whose intervals of each coordinate are then those that it has without the others: Student's t
        and chi2 with n - 1 degrees of freedom for n - d.
        """
        return replace(self, degrees=self.degrees + self.coordinates - 1)

    @property
    def coordinates(self) -> int:
        """D."""
        return self.centre.shape[-1]

    @property
    def marginal_degrees(self) -> float:
        """Degrees of freedom of one coordinate: nu - d + 1."""
        return self.degrees - self.coordinates + 1

    def updated(self, shots: Array) -> NormalInverseWishart:
        """After shots (..., n, d)."""
        count = shots.shape[-2]
        mean = shots.mean(axis=-2)
        deviations, offset = shots - mean[..., None, :], mean - self.centre
        strength = self.strength + count
        shrinkage = self.strength * count / strength
        return NormalInverseWishart(
            centre=(self.strength * self.centre + count * mean) / strength,
            strength=strength,
            scale=self.scale + _square(deviations) + shrinkage * offset[..., :, None] * offset[..., None, :],
            degrees=self.degrees + count,
        )

    def mean_interval(self, level: float) -> Interval:
        """Of each coordinate's mean, (..., d): Student's t with marginal_degrees."""
        free = self.marginal_degrees
        low, high = stats.t.interval(level, free, self.centre, np.sqrt(self._diagonal / (self.strength * free)))
        return np.asarray(low), np.asarray(high)

    def mean_distance(self, mean: Array) -> Array:
        """How far a mean (..., d) is out, (...): it is in the ellipsoid of probability p where this is at most p."""
        free, offset = self.marginal_degrees, mean - self.centre
        squares = np.sum(offset * np.linalg.solve(self.scale, offset[..., None])[..., 0], axis=-1)
        inside: Array = stats.f.cdf(self.strength * free / self.coordinates * squares, self.coordinates, free)
        return inside

    def spread(self, probability: float = 0.5) -> Array:
        """Quantile of each coordinate's standard deviation, (..., d): scale / chi2 with marginal_degrees."""
        return np.asarray(np.sqrt(self._diagonal / stats.chi2.ppf(1.0 - probability, self.marginal_degrees)))

    def spread_interval(self, level: float) -> Interval:
        """Of each coordinate's standard deviation, (..., d)."""
        return self.spread(0.5 - 0.5 * level), self.spread(0.5 + 0.5 * level)

    def covariances(self, count: int, generator: np.random.Generator) -> Array:
        """Draws of the covariance, (..., count, d, d); several problems share their random numbers."""
        unit = np.eye(self.coordinates)
        drawn = stats.invwishart(self.degrees, unit).rvs(count, random_state=generator)
        root = np.linalg.cholesky(self.scale)[..., None, :, :]
        return np.asarray(root @ np.reshape(drawn, (count, *unit.shape)) @ np.swapaxes(root, -1, -2))

    @property
    def _diagonal(self) -> Array:
        return np.diagonal(self.scale, axis1=-2, axis2=-1)


def _square(deviations: Array) -> Array:
    found: Array = np.swapaxes(deviations, -1, -2) @ deviations
    return found
