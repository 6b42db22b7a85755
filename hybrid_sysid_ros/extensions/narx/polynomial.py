"""A polynomial whose coefficients are learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.blocks import Block, Kernels
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class Polynomial(Block):
    """y = sum_j w_j prod_i z_i^e_ji. exponents: e, of each term (features,). Weights: the coefficients (terms,)."""

    exponents: tuple[tuple[int, ...], ...]
    features: int
    outputs: int = 1
    at: int = 0

    @property
    def size(self) -> int:  # type: ignore[override]
        return len(self.exponents)

    @property
    def kernels(self) -> Kernels:
        factors = [[i for i, power in enumerate(term) for _ in range(power)] for term in self.exponents]
        order = np.array([i for term in factors for i in term], dtype=np.int64)
        ends = np.cumsum([0, *(len(term) for term in factors)])
        terms, features = len(factors), self.features

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            y[0] = 0.0
            for j in range(terms):
                product = w[at + j]
                for k in range(ends[j], ends[j + 1]):
                    product *= z[order[k]]
                y[0] += product

        @inner
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            value(w, at, z, y)
            for i in range(features):
                by_z[i] = 0.0
            for j in range(terms):
                for k in range(ends[j], ends[j + 1]):
                    product = w[at + j]
                    for other in range(ends[j], ends[j + 1]):
                        if other != k:
                            product *= z[order[other]]
                    by_z[order[k]] += product

        @inner
        def weight_gradient(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            for j in range(terms):
                product = factors[0]
                for k in range(ends[j], ends[j + 1]):
                    product *= z[order[k]]
                row[start + j] += product

        return value, jacobian, weight_gradient

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        total: Scalar = 0.0
        for weight, term in zip(w, self.exponents, strict=True):
            product = weight
            for value, power in zip(z, term, strict=True):
                for _ in range(power):
                    product = product * value
            total = total + product
        return [total]
