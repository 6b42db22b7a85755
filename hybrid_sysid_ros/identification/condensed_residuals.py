"""Condensed residuals: a least-squares problem of many rows becomes an equivalent one of few rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Function = Callable[[Array], Array]

SHIFTS = (0.0, 1e-14, 1e-12, 1e-10, 1e-8)
"""Shares of the largest diagonal entry, added to the diagonal until the normal equations are positive definite."""


class CondensedResiduals:
    """Residuals f (rows,) and Jacobian J (rows, n) in a basis whose first vector is f / |f|.

        f~ = (|f|, 0, ..., 0),   J~ = [f'J / |f|; R],   R'R = J'J - J'f f'J / f'f       n + 1 rows

    |f|, J'f and J'J do not change, and an optimiser's steps depend on nothing else. Normal equations and their Cholesky
    factor cost a sixth of the singular value decomposition of J; the optimiser then decomposes R alone. They square the
    condition number of J, so every direction needs a prior.
    """

    def __init__(self, residuals: Function, jacobian: Function) -> None:
        self._residuals, self._jacobian = residuals, jacobian
        self._point: Array = np.zeros(0)
        self._errors: Array = np.zeros(0)

    def residuals(self, point: Array) -> Array:
        """f~, (n + 1,)."""
        found: Array = np.zeros(len(point) + 1)
        found[0] = np.linalg.norm(self._at(point))
        return found

    def jacobian(self, point: Array) -> Array:
        """J~, (n + 1, n)."""
        errors, jacobian = self._at(point), self._jacobian(point)
        along = errors @ jacobian / max(float(np.linalg.norm(errors)), 1e-300)
        return np.asarray(np.vstack([along, _root(jacobian.T @ jacobian - np.outer(along, along))]))

    def _at(self, point: Array) -> Array:
        """The residuals f; the optimiser asks for them before it asks for J at the same point."""
        if not np.array_equal(point, self._point):
            self._point, self._errors = point.copy(), self._residuals(point)
        return self._errors


def _root(normal: Array) -> Array:
    """The factor R of normal = R'R. Raises UserError where there is none."""
    largest = normal.diagonal().max()
    for shift in SHIFTS:
        try:
            shifted = normal + shift * largest * np.eye(len(normal))
            return np.asarray(scipy.linalg.cholesky(shifted, check_finite=False))
        except np.linalg.LinAlgError:
            continue
    raise UserError("identification: the errors do not determine the learned part; take fewer units")
