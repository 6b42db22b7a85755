"""The range of what a policy was trained on: beyond it, its network knows nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIDGE = 1e-3
"""Variance added to every standardised feature, so that directions in which the data hardly vary are not counted as
known to a hair: the previews of a smooth reference lie almost in a plane."""

UNBOUNDED = 1e12
"""Of a feature whose box says nothing."""

ROUNDING = 1e-9
"""Relative, far above that of the numbers themselves."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingRange:
    """Features within low and high (features,), and |whitening (z - centre) / scale| within ``reach``.

    The first is the box of the training data, the second their ellipsoid (Mahalanobis distance), which tells that a
    state and a reference never met even where each alone was seen. whitening (features, features): inverse of the
    Cholesky factor of the covariance of the standardised features, lower triangular.
    """

    low: Array
    high: Array
    whitening: Array
    reach: float

    def __post_init__(self) -> None:
        count = len(self.low)
        if self.high.shape != (count,) or self.whitening.shape != (count, count) or not np.all(self.low <= self.high):
            raise UserError(f"policy: the training range does not fit its {count} features")
        if not self.reach >= 0:
            raise UserError(f"policy: the reach of the training range is {self.reach}; it must not be negative")

    @classmethod
    def of(cls, features: Array, centre: Array, scale: Array) -> TrainingRange:
        """The range of training data (samples, features), all of which lie within it."""
        standardised = (features - centre) / scale
        covariance = standardised.T @ standardised / len(features) + RIDGE * np.eye(features.shape[1])
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        squares = np.sum((standardised @ whitening.T) ** 2, axis=1)
        low, high = features.min(axis=0), features.max(axis=0)
        # A hair more, for compiled code adds in another order.
        hair = ROUNDING * np.maximum(np.abs(low), np.abs(high))
        reach = float(np.sqrt(squares.max()) * (1 + ROUNDING))
        return cls(low=low - hair, high=high + hair, whitening=whitening, reach=reach)

    def onto(self, raw: Array) -> TrainingRange:
        """The same of standardised raw features, of which these are the map ``raw`` (features, features), lower
        triangular: of what they don't depend on alone the box says nothing.
        """
        free = np.any(raw != np.eye(len(raw)), axis=0) | np.any(raw != np.eye(len(raw)), axis=1)
        low, high = np.where(free, -UNBOUNDED, self.low), np.where(free, UNBOUNDED, self.high)
        return replace(self, low=low, high=high, whitening=self.whitening @ raw)

    @property
    def packed(self) -> Array:
        """low, high, reach and the rows of the whitening matrix, one after another."""
        return np.concatenate([self.low, self.high, [self.reach], self.whitening.ravel()])
