"""The region of training data, beyond which what was learned fades out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.support.arrays import Array

FADED = 2.0
"""Where nothing is left of what was learned, in distances of the training data's edge from their mean."""
NARROW = 1e-6
"""Least share of a feature's variance that the others may leave of it: below it, they are the feature."""


@dataclass(frozen=True)
class Region:
    """An ellipsoid in the space of features z about the mean m of the training data, of their covariance's shape.

        d^2 = |R (z - m)|^2, which is 1 for the farthest sample

    d is a distance of Mahalanobis (1936). What was learned counts in whole within d = 1, and not at all beyond
    :data:`FADED`; between them by (1 - s)^2 (1 + 2 s), s = (d^2 - 1) / (FADED^2 - 1), with a continuous slope.
    """

    numbers: tuple[Scalar, ...]
    """M (features,), then the rows of R, lower triangular; they may be symbols."""
    features: int

    @classmethod
    def everywhere(cls, features: int) -> Region:
        """Without an edge."""
        return cls((0.0,) * cls.size(features), features)

    @classmethod
    def of(cls, points: Array) -> Region:
        """That of training data, points (samples, features)."""
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
        """How many numbers it has."""
        return features + features * (features + 1) // 2

    @staticmethod
    def names(features: Sequence[str]) -> list[str]:
        """Of its numbers, by those of the features."""
        rows = (f"region_{name}_{other}" for i, name in enumerate(features) for other in features[: i + 1])
        return [*(f"region_{name}" for name in features), *rows]

    def share(self, z: Sequence[Scalar]) -> Scalar:
        """Part of what was learned that counts at z (features,)."""
        n = self.features
        away = [value - mean for value, mean in zip(z, self.numbers, strict=False)]
        total: Scalar = 0.0
        for i in range(n):
            first = n + i * (i + 1) // 2
            row = sum(factor * value for factor, value in zip(self.numbers[first : first + i + 1], away, strict=False))
            total = total + row * row
        s = clip((total - 1.0) / (FADED**2 - 1.0), 0.0, 1.0)
        return (1.0 - s) ** 2 * (1.0 + 2.0 * s)
