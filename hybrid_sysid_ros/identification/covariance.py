"""How sure a least-squares estimate is, when its errors are correlated in time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.support.arrays import Array

LONGEST_LAG = 200
"""Samples after which errors of a free run count as unrelated, at most; 10 s of the usual 50 ms."""


def covariances(jacobian: Array, residuals: Array, edges: NDArray[np.int64]) -> tuple[Array, Array]:
    """Covariance of a solution twice: as if the residuals were independent of deviation one, and robust.

    jacobian (rows, n), residuals (rows,): the rows of record i are edges[i] to edges[i + 1], in time; those after
    edges[-1] are priors. With H = J' J and the scores s_t = J_t e_t the robust one is

        H^-1 (sum_k w_k sum_t s_t s_{t+k}' + J_prior' J_prior) H^-1,   w_k = 1 - |k| / (L + 1), within a record,

    which holds whatever the colour of the errors: Newey & West (1987), Econometrica 55(3); for free runs, whose errors
    are never white, Ljung (1999), System Identification, 2nd ed., section 9.2. L: a quarter of the shortest record, at
    most LONGEST_LAG.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    priors = jacobian[edges[-1] :]
    middle = priors.T @ priors
    lags = int(max(0, min(LONGEST_LAG, np.min(np.diff(edges)) // 4)))
    for begin, end in pairwise(edges):
        scores = jacobian[begin:end] * residuals[begin:end, None]
        # Sums over L + 1 samples, squared: the same as the weighted sum over lags.
        total = np.cumsum(
            np.concatenate([np.zeros((lags + 1, scores.shape[1])), scores, np.zeros((lags, scores.shape[1]))]), 0
        )
        sums = total[lags + 1 :] - total[: -lags - 1]
        middle = middle + sums.T @ sums / (lags + 1)
    return inverse, inverse @ middle @ inverse
