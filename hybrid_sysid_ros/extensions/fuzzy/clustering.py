"""Fuzzy clusters: where the rules of a model lie."""

from __future__ import annotations

import numpy as np
from scipy.cluster.vq import kmeans2

from hybrid_sysid_ros.extensions.fuzzy.memberships import NEAREST, memberships
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

ITERATIONS, TOLERANCE = 300, 1e-7
BEGINNINGS = 8
"""Of fuzzy C-means, each at the centres of k-means; the least objective stays."""
SLENDER = 1e-10
"""Least ratio of a cluster's variances: below it, its points lie on a line."""
HALF = float(np.sqrt(np.log(2.0)))
"""Distance over the width at which exp(-(d / b)^2) is a half."""
APART = 1e-6
"""Least distance of two centres, in the scales of the points."""


def fuzzy_c_means(points: Array, clusters: int, *, seed: int = 0) -> Array:
    """Centres (clusters, variables) that minimise sum_t sum_i h_ti^2 |z_t - c_i|^2, h the memberships of the points.

    points (samples, variables), scaled. Bezdek (1981), Pattern recognition with fuzzy objective function algorithms,
    algorithm 11.1, exponent 2. Raises UserError for more clusters than different points, and for centres that coincide.
    """
    found = [_c_means(points, start) for start in _beginnings(points, clusters, seed)]
    centres = min(found, key=lambda item: _objective(points, item))
    _check_apart(centres)
    return centres


def gustafson_kessel(points: Array, clusters: int, *, seed: int = 0) -> tuple[Array, Array]:
    """Centres and widths (clusters, variables) of clusters that are ellipsoids of volume one, by their axes.

    Distances are (z - c_i)' A_i (z - c_i), A_i = det(F_i)^(1/n) F_i^-1, F_i the fuzzy covariance; widths are those of
    its diagonal. Gustafson and Kessel (1979), Fuzzy clustering with a fuzzy covariance matrix, IEEE CDC, eq. (8)-(11).
    Raises UserError as :func:`fuzzy_c_means` does, and for a singular cluster.
    """
    centres, n = fuzzy_c_means(points, clusters, seed=seed), points.shape[1]
    h = memberships(points, centres, np.ones_like(centres))
    for _ in range(ITERATIONS):
        before = h
        parts = h**2 / np.sum(h**2, axis=0)
        centres = parts.T @ points
        away = points[:, None, :] - centres
        covariances = np.einsum("ti,tij,tik->ijk", parts, away, away)
        _check_regular(covariances)
        norms = np.linalg.det(covariances)[:, None, None] ** (1.0 / n) * np.linalg.inv(covariances)
        close = 1.0 / (NEAREST + np.einsum("tij,ijk,tik->ti", away, norms, away))
        h = close / close.sum(axis=1, keepdims=True)
        if np.max(np.abs(h - before)) < TOLERANCE:
            break
    _check_apart(centres)
    variances = np.einsum("ijj->ij", covariances)
    return centres, np.sqrt(variances / np.prod(variances, axis=1, keepdims=True) ** (1.0 / n))


def k_means(values: Array, clusters: int, *, seed: int = 0) -> Array:
    """Centres (clusters,) of the values of one variable (samples,), in their order, the least squared distance of
    several beginnings. Raises UserError for more clusters than different values.
    """
    found = _beginnings(values[:, None], clusters, seed)
    best = min(found, key=lambda item: float(np.sum(np.min((values[:, None] - item[:, 0]) ** 2, axis=1))))
    return np.sort(best[:, 0])


def _beginnings(points: Array, clusters: int, seed: int) -> list[Array]:
    different = len(np.unique(points, axis=0))
    if clusters > different:
        raise UserError(f"fuzzy rules: {clusters} of them for {different} different points; take {different} or fewer")
    random = np.random.default_rng(seed)
    return [kmeans2(points, clusters, minit="++", seed=random, missing="warn")[0] for _ in range(BEGINNINGS)]


def _c_means(points: Array, centres: Array) -> Array:
    widths = np.ones_like(centres)
    for _ in range(ITERATIONS):
        parts = memberships(points, centres, widths) ** 2
        moved = (parts.T @ points) / np.sum(parts, axis=0)[:, None]
        far = np.max(np.abs(moved - centres))
        centres = moved
        if far < TOLERANCE:
            break
    return centres


def _objective(points: Array, centres: Array) -> float:
    """The least one for given centres: sum_t 1 / sum_i d_ti^-2, Bezdek (1981), eq. (11.5)."""
    squares = np.sum((points[:, None, :] - centres) ** 2, axis=2) + NEAREST
    return float(np.sum(1.0 / np.sum(1.0 / squares, axis=1)))


def _check_apart(centres: Array) -> None:
    for i, centre in enumerate(centres[1:], start=1):
        near = int(np.argmin(np.linalg.norm(centres[:i] - centre, axis=1)))
        if np.linalg.norm(centres[near] - centre) < APART:
            raise UserError(
                f"fuzzy rules: rules {near + 1} and {i + 1} have the same centre, so nothing tells them apart; "
                "take fewer rules or other premises"
            )


def _check_regular(covariances: Array) -> None:
    for i, covariance in enumerate(covariances):
        values = np.linalg.eigvalsh(covariance)
        if not values[0] > SLENDER * values[-1]:
            raise UserError(
                f"fuzzy rules: cluster {i + 1} is singular, its points lie on a line or a plane; take fewer rules, "
                "other premises, or fuzzy C-means (gustafson_kessel=0)"
            )
