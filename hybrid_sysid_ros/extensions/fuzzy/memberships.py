"""Memberships in the rules of a fuzzy model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.blocks import Block, Kernels
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar, exp
from hybrid_sysid_ros.core.registers import scratch
from hybrid_sysid_ros.support.arrays import Array

NEAREST = 1e-12
"""Added to squared distances: at a centre its rule has all of the membership."""


@dataclass(frozen=True, kw_only=True)
class Memberships(Block):
    """h_i = g_i / sum_k g_k, with g_i = 1 / d_i^2 and d_i^2 = sum_j ((z_j - c_ij) / b_ij)^2: the outputs add up to one.

    With all b one these are the memberships of fuzzy C-means with exponent 2: Bezdek (1981), Pattern recognition with
    fuzzy objective function algorithms, eq. (11.3a).

    Weights, for each rule: centre c_i (features,), logarithms of the widths b_i (features,).
    """

    features: int
    rules: int
    at: int = 0

    @property
    def outputs(self) -> int:  # type: ignore[override]
        return self.rules

    @property
    def size(self) -> int:  # type: ignore[override]
        return 2 * self.rules * self.features

    @property
    def kernels(self) -> Kernels:
        rules, features = self.rules, self.features

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            shares(w, at, z, rules, features, y)

        @inner
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            share_jacobian(w, at, z, rules, features, y, by_z)

        @inner
        def weight_gradient(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            h = scratch(rules)
            shares(w, at, z, rules, features, h)
            add_weight_gradient(w, at, z, rules, features, h, factors, row, start)

        return value, jacobian, weight_gradient

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        n, close = self.features, []
        for i in range(self.rules):
            centre, log_width = w[2 * i * n : (2 * i + 1) * n], w[(2 * i + 1) * n : (2 * i + 2) * n]
            d = [(value - c) * exp(-b) for value, c, b in zip(z, centre, log_width, strict=True)]
            close.append(1.0 / (NEAREST + sum(item * item for item in d)))
        total = sum(close)
        return [g / total for g in close]


@inner
def closeness(w: Any, at: int, z: Any, features: int, i: int) -> float:
    """Inverse of the squared distance from the centre of rule i."""
    distance = NEAREST
    for j in range(features):
        d = (z[j] - w[at + 2 * i * features + j]) * math.exp(-w[at + (2 * i + 1) * features + j])
        distance += d * d
    return 1.0 / distance  # type: ignore[no-any-return]


@inner
def shares(w: Any, at: int, z: Any, rules: int, features: int, h: Any) -> None:
    """The memberships h (rules,)."""
    total = 0.0
    for i in range(rules):
        h[i] = closeness(w, at, z, features, i)
        total += h[i]
    for i in range(rules):
        h[i] /= total


@inner
def share_jacobian(w: Any, at: int, z: Any, rules: int, features: int, h: Any, by_z: Any) -> None:
    """And their derivatives by z (rules x features), along rows: dh_i = h_i (a_i - sum_k h_k a_k), a_i = d log g_i."""
    shares(w, at, z, rules, features, h)
    for i in range(rules):
        g = closeness(w, at, z, features, i)
        for j in range(features):
            scale = math.exp(-w[at + (2 * i + 1) * features + j])
            by_z[i * features + j] = -2.0 * g * scale * scale * (z[j] - w[at + 2 * i * features + j])
    for j in range(features):
        mean = 0.0
        for i in range(rules):
            mean += h[i] * by_z[i * features + j]
        for i in range(rules):
            by_z[i * features + j] = h[i] * (by_z[i * features + j] - mean)


@inner
def add_weight_gradient(
    w: Any, at: int, z: Any, rules: int, features: int, h: Any, factors: Any, row: Any, start: int
) -> None:
    """Add sum_i factors[i] dh_i/dw to row[start:], h the memberships."""
    mean = 0.0
    for i in range(rules):
        mean += factors[i] * h[i]
    for i in range(rules):
        by_log = 2.0 * h[i] * (factors[i] - mean) * closeness(w, at, z, features, i)
        for j in range(features):
            scale = math.exp(-w[at + (2 * i + 1) * features + j])
            d = (z[j] - w[at + 2 * i * features + j]) * scale
            row[start + 2 * i * features + j] += by_log * d * scale
            row[start + (2 * i + 1) * features + j] += by_log * d * d


def packed(centres: Array, widths: Array) -> Array:
    """The weights of :class:`Memberships` from centres and widths (rules, features)."""
    return np.stack([centres, np.log(widths)], axis=1).ravel()


def unpacked(weights: Array, rules: int) -> tuple[Array, Array]:
    """Centres and widths (rules, features) of the weights of :class:`Memberships`."""
    centres, logarithms = np.moveaxis(np.reshape(weights, (rules, 2, -1)), 1, 0)
    return centres, np.exp(logarithms)


def memberships(z: Array, centres: Array, widths: Array) -> Array:
    """The same of many features (samples, features) at once, (samples, rules)."""
    squares = np.sum(((z[:, None, :] - centres) / widths) ** 2, axis=2)
    close = 1.0 / (NEAREST + squares)
    return np.asarray(close / close.sum(axis=1, keepdims=True))
