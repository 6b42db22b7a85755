"""Standard errors of a fit: covariances that hold where errors have a colour and simulations have corners."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from hybrid_sysid_ros.support.arrays import Array

LONGEST_LAG = 200
"""Largest lag at which errors of a free run count as correlated, in rows, which are the samples of all outputs: 10 s at
the usual 50 ms for one output.
"""
SLOW_BLOCKS, FEWEST, SEEN = 32, 8, 2.0
"""Blocks of all records, and the fewest of one, between which errors show how slowly they change; and from how many of
its standard errors a correlation of neighbours counts.
"""
LEVEL = 0.9
"""Of the intervals for which the standard errors of short records are widened."""
KNOWN = 1e-9
"""Least eigenvalue of the scaled information of a direction that data or priors determine."""
TOUCHED = 1e-3
"""Least part of a parameter in a direction that nothing determines, at which it is unknown, too."""
BLOCKS = 4
"""Of records, whose estimates are compared."""
SECANTS, MOST = 3, 80
"""Rounds in which the lengths of secants settle, and the most columns of which they are computed."""
ALONE = 0.99
"""Sum of squared shares from which one block alone determines a number."""


def covariances(
    jacobian: Array,
    residuals: Array,
    edges: NDArray[np.int64],
    *,
    priors: Array | None = None,
    shifts: Array | None = None,
) -> tuple[Array, Array]:
    """Two covariances of a solution (n, n): for independent residuals of deviation one, and a robust one.

    jacobian (rows, n), residuals (rows,): record i has the rows edges[i] to edges[i + 1], in order of time; the rows
    after edges[-1] are priors, whose own covariance is ``priors``, by default of deviation one. With H = J' J and the
    scores s_t = J_t e_t the robust one is

        H^-1 (sum_k w_k sum_t s_t s_{t+k}' f + J_prior' C J_prior) H^-1,   w_k = 1 - |k| / (L_i + 1), within a record,

    which holds for errors of any colour: Newey & West (1987), Econometrica 55(3); for free runs, whose errors
    are never white, Ljung (1999), System Identification, 2nd ed., section 9.2. L_i: a quarter of the record, at
    most LONGEST_LAG. f widens it for short records: the sum has about 1.5 sum_i N_i / L_i degrees of freedom, so that a
    normal interval is too short (Kiefer & Vogelsang 2005, Econometric Theory 21(6)), and the scores' sum is zero by the
    fit. Where errors are slower than the lags see, it is as large as :func:`slow_variances`.
    shifts (k, rows): errors of the rows that are known up to their sign, such as that of the integration step; each
    adds the square of what it moves.

    What neither data nor priors determine has rows and columns of zero.
    """
    information = jacobian.T @ jacobian
    inverse, unknown = _inverse(information)
    rows = jacobian[edges[-1] :]
    lags = _lags(edges)
    robust = widening(edges, lags) * inverse @ long_run(jacobian, residuals, edges, lags) @ inverse
    slow = slow_variances((jacobian[: edges[-1]] * residuals[: edges[-1], None]) @ inverse, edges)
    stretch = np.sqrt(np.maximum(slow / np.maximum(np.diag(robust), np.finfo(float).tiny), 1.0))
    robust *= np.outer(stretch, stretch)
    robust += inverse @ (rows.T @ (rows if priors is None else priors @ rows)) @ inverse
    for shift in () if shifts is None else shifts:
        moved = inverse @ (jacobian.T @ shift)
        robust = robust + np.outer(moved, moved)
    for found in (inverse, robust):
        found[unknown], found[:, unknown] = 0.0, 0.0
    return inverse, robust


def long_run(jacobian: Array, residuals: Array, edges: NDArray[np.int64], longest: NDArray[np.int64]) -> Array:
    """The long-run covariance of the scores times their number, (n, n), by Bartlett's weights. longest: L_i
    (records,).
    """
    found = np.zeros((jacobian.shape[1], jacobian.shape[1]))
    for (begin, end), lags in zip(pairwise(edges), longest.tolist(), strict=True):
        scores = jacobian[begin:end] * residuals[begin:end, None]
        # Squared sums over L + 1 samples equal the weighted sum over lags.
        total = np.cumsum(
            np.concatenate([np.zeros((lags + 1, scores.shape[1])), scores, np.zeros((lags, scores.shape[1]))]), 0
        )
        sums = total[lags + 1 :] - total[: -lags - 1]
        found += sums.T @ sums / (lags + 1)
    return found


def slow_variances(influence: Array, edges: NDArray[np.int64]) -> Array:
    """Variances (n,) of the sums of what the errors of all rows add to a solution, (rows, n), by blocks z.

        z_b = r z_{b-1} + w_b,   Var(sum_b z_b) = sum_b w_b^2 / (1 - r)^2,

    since gusts and drifts that live longer than the lags of a long-run covariance are not in it: Andrews & Monahan
    (1992), Econometrica 60(4). In n blocks r has a bias of -(1 + 3 r) / n (Kendall 1954, Biometrika 41); it is below 1.
    """
    rows, records = int(edges[-1]), len(edges) - 1
    length = max(rows // max(SLOW_BLOCKS, FEWEST * records), 1)
    cuts = [np.linspace(a, b, max((b - a) // length, 1) + 1).astype(int)[:-1] for a, b in pairwise(edges.tolist())]
    blocks = np.split(
        np.add.reduceat(influence, np.concatenate(cuts), axis=0), np.cumsum([len(cut) for cut in cuts])[:-1]
    )
    before, after = (np.concatenate([record[part] for record in blocks]) for part in (slice(-1), slice(1, None)))
    total, squares = sum(map(len, cuts)), np.maximum(np.sum(before**2, axis=0), np.finfo(float).tiny)
    found = np.sum(before * after, axis=0) / squares
    unbiased = np.minimum(found + (1.0 + 3.0 * found) / total, 1.0 - 1.5 / total)
    kept = np.where(found > SEEN / np.sqrt(total), unbiased, 0.0)
    left = np.sum((after - kept * before) ** 2, axis=0) * total / max(len(after), 1)
    return np.asarray(left / (1.0 - kept) ** 2)


def block_spread(jacobian: Array, residuals: Array, edges: NDArray[np.int64]) -> Array:
    """Standard errors (n,) by the spread of what each record, or block of one, would say alone, from one Gauss-Newton
    step; at least BLOCKS blocks, each with all priors, and as heavy as it determines the number (inverse variances;
    Cochran 1954, Biometrics 10(1)). It grows with errors of the model, which differ between blocks; infinite where one
    of them alone determines a number, or none.
    """
    cuts, pieces = [0], -(-BLOCKS // (len(edges) - 1))
    for begin, end in pairwise(edges):
        cuts += np.linspace(begin, end, pieces + 1).astype(int)[1:].tolist()
    rows = slice(edges[-1], None)
    prior, gradient = jacobian[rows].T @ jacobian[rows], jacobian[rows].T @ residuals[rows]
    moves, weights = [], []
    for begin, end in pairwise(cuts):
        own = jacobian[begin:end]
        inverse, unknown = _inverse(own.T @ own + prior)
        moves.append(inverse @ (own.T @ residuals[begin:end] + gradient))
        weights.append(np.where(unknown, 0.0, 1.0 / np.where(unknown, 1.0, np.diag(inverse))))
    total = np.sum(weights, axis=0)
    shares = np.array(weights) / np.maximum(total, np.finfo(float).tiny)
    squares = np.square(np.array(moves) - np.sum(shares * moves, axis=0))
    one = np.sum(shares**2, axis=0)  # of as many equal blocks
    several = (total > 0.0) & (one < ALONE)
    return np.where(
        several, np.sqrt(np.sum(shares * squares, axis=0) * one / np.where(several, 1.0 - one, 1.0)), np.inf
    )


def confidence(jacobian: Array, residuals: Array, edges: NDArray[np.int64]) -> float:
    """How much larger the errors' weight against the priors could be, as a factor of the residuals: with it the scores
    vary on average as much as the curvature of the cost says.
    """
    data = jacobian[: edges[-1]]
    lags = _lags(edges)
    inverse, _ = _inverse(jacobian.T @ jacobian)
    expected = float(np.trace(inverse @ (data.T @ data)))
    met = float(np.trace(inverse @ long_run(jacobian, residuals, edges, lags)))
    return float(np.sqrt(expected / met)) if met > 0.0 else 1.0


def secant_jacobian(
    function: Callable[[Array], Array], point: Array, jacobian: Array, edges: NDArray[np.int64]
) -> Array:
    """The Jacobian (rows, n) over the distance of a standard error, by central differences.

    Where sticking begins or ends, a simulation has a corner, whose derivative at one point says nothing of the way to
    the next: a single one can make a standard error five times too small.
    """
    if len(point) > MOST:
        return jacobian
    residuals = function(point)
    for _ in range(SECANTS):
        _, robust = covariances(jacobian, residuals, edges)
        steps = np.sqrt(np.diag(robust))
        columns = [
            (function(point + move) - function(point - move)) / (2.0 * step) if step > 0.0 else jacobian[:, k]
            for k, (step, move) in enumerate(zip(steps, np.diag(steps), strict=True))
        ]
        jacobian = np.stack(columns, axis=1)
    return jacobian


def _lags(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """L of each record: a quarter of it, at most LONGEST_LAG."""
    return np.minimum(np.diff(edges) // 4, LONGEST_LAG)


def _inverse(information: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The inverse of an information matrix (n, n), and which parameters nothing determines, (n,)."""
    scales = np.sqrt(np.diag(information))
    unknown = ~(scales > 0.0)
    scales = np.where(unknown, 1.0, scales)
    values, vectors = np.linalg.eigh(information / np.outer(scales, scales) + np.diag(unknown.astype(float)))
    weak = values < KNOWN * values[-1]
    unknown = unknown | (np.abs(vectors[:, weak]) > TOUCHED).any(axis=1)
    strong = vectors[:, ~weak] / scales[:, None]
    return np.asarray((strong / values[~weak]) @ strong.T), unknown


def widening(edges: NDArray[np.int64], lags: NDArray[np.int64]) -> float:
    """The factor f of a covariance for records of the given rows, with lags (records,); 1 for long ones."""
    rows, longest = np.diff(edges), int(np.max(lags)) + 1
    return student_factor(1.5 * float(np.sum(rows / (lags + 1)))) ** 2 / (1.0 - min(longest / int(edges[-1]), 0.5))


def student_factor(freedom: float) -> float:
    """By how much a Student's interval of LEVEL is longer than a normal one, for at least two degrees of freedom."""
    level = 0.5 + 0.5 * LEVEL
    return float(scipy.stats.t.ppf(level, max(freedom, 2.0)) / scipy.stats.norm.ppf(level))
