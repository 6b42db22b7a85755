"""The region of training data, beyond which the learned part fades out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.support.arrays import Array

FADED = 2.0
"""Distance from the mean at which the learned part has faded to zero; the edge of the training data is at 1."""
NARROW = 1e-6
"""Share of a feature's variance that is independent of the others, below which it counts as a function of them."""


@dataclass(frozen=True)
class Region:
    """An ellipsoid in the space of features z about the mean m of the training data, of their covariance's shape.

        d^2 = |R (z - m)|^2, which is 1 for the farthest sample

    d is a distance of Mahalanobis (1936). The learned part counts fully within d = 1 and not at all beyond
    :data:`FADED`; in between its share is (1 - s)^2 (1 + 2 s), s = (d^2 - 1) / (FADED^2 - 1), which is smooth.
    """

    numbers: tuple[Scalar, ...]
    """M (features,), then the rows of R, lower triangular; they may be symbols."""
    features: int

    @classmethod
    def everywhere(cls, features: int) -> Region:
        """A region without an edge."""
        return cls((0.0,) * cls.size(features), features)

    @classmethod
    def of(cls, points: Array) -> Region:
        """The region of training data, points (samples, features)."""
        mean = points.mean(axis=0)
        away = points - mean
        covariance = np.atleast_2d(np.cov(away.T))
        covariance += NARROW * np.diag(np.maximum(np.diag(covariance), NARROW))
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        root /= np.sqrt(np.max(np.sum((away @ root.T) ** 2, axis=1)))
        features = points.shape[1]
        return cls((*mean.tolist(), *root[np.tril_indices(features)].tolist()), features)

    @staticmethod
    def size(features: int) -> int:
        """Number of ``numbers``."""
        return features + features * (features + 1) // 2

    @staticmethod
    def names(features: Sequence[str]) -> list[str]:
        """Names of the ``numbers``, made of the features' names."""
        rows = (f"region_{name}_{other}" for i, name in enumerate(features) for other in features[: i + 1])
        return [*(f"region_{name}" for name in features), *rows]

    def share(self, z: Sequence[Scalar]) -> Scalar:
        """Share of the learned part that counts at z (features,)."""
        n = self.features
        away = [value - mean for value, mean in zip(z, self.numbers, strict=False)]
        total: Scalar = 0.0
        for i in range(n):
            first = n + i * (i + 1) // 2
            row = sum(factor * value for factor, value in zip(self.numbers[first : first + i + 1], away, strict=False))
            total = total + row * row
        s = clip((total - 1.0) / (FADED**2 - 1.0), 0.0, 1.0)
        return (1.0 - s) ** 2 * (1.0 + 2.0 * s)
