"""The five layers of a fuzzy-neural network (DIFNN)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.blocks import Block, Kernels
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar, exp, maximum
from hybrid_sysid_ros.core.registers import scratch


@dataclass(frozen=True, kw_only=True)
class LinkedRules(Block):
    """y_k = sum_s f_r d_kl a_kl / sum_s f_r d_kl, s the links of output k from a rule r to a term l: centre of area.

    The layers are inputs z_j; terms m_jt = exp(-((z_j - c_jt) / b_jt)^2) of each; rules f_r, the product of a term of
    each input; terms of each output with centres a_kl and widths d_kl, each fed by the rules that are linked to it; and
    outputs. Both sums are divided by the largest of their terms, so that far from all centres the nearest rule is left.

    Weights: for each input centres c_j (terms,), logarithms of b_j (terms,); then for each output those of a_k, d_k
    (terms,).
    """

    rules: tuple[tuple[int, ...], ...]
    """Of each rule its terms, (features,)."""
    links: tuple[tuple[tuple[int, int], ...], ...]
    """Of each output its links, a rule and a term of the output each."""
    terms: int
    """Of each input and of each output."""
    at: int = 0

    @property
    def features(self) -> int:  # type: ignore[override]
        return len(self.rules[0])

    @property
    def outputs(self) -> int:  # type: ignore[override]
        return len(self.links)

    @property
    def size(self) -> int:  # type: ignore[override]
        return 2 * (self.features + self.outputs) * self.terms

    @property
    def kernels(self) -> Kernels:
        features, outputs, terms = self.features, self.outputs, self.terms
        antecedents = np.array(self.rules, dtype=np.int64)
        links = np.array([link for of in self.links for link in of], dtype=np.int64)
        ends = np.cumsum([0, *map(len, self.links)])
        most = max(map(len, self.links))

        @inner
        def apart(w: Any, at: int, z: Any, s: int, j: int) -> float:
            """(z_j - c) / b of the term of a link's rule."""
            place = at + 2 * j * terms + antecedents[links[s, 0], j]
            return (z[j] - w[place]) * math.exp(-w[place + terms])  # type: ignore[no-any-return]

        @inner
        def centre(k: int, s: int) -> int:
            """Place of the centre of the term that a link leads to; its width comes ``terms`` later."""
            return 2 * (features + k) * terms + links[s, 1]  # type: ignore[no-any-return]

        @inner
        def shares(w: Any, at: int, z: Any, k: int, p: Any) -> float:
            """Part p (links,) of each link in an output, and the output."""
            first, count, largest = ends[k], ends[k + 1] - ends[k], -math.inf
            for i in range(count):
                p[i] = w[at + centre(k, first + i) + terms]
                for j in range(features):
                    d = apart(w, at, z, first + i, j)
                    p[i] -= d * d
                largest = max(largest, p[i])
            total, weighed = 0.0, 0.0
            for i in range(count):
                p[i] = math.exp(p[i] - largest)
                total += p[i]
                weighed += p[i] * w[at + centre(k, first + i)]
            for i in range(count):
                p[i] /= total
            return weighed / total  # type: ignore[no-any-return]

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            p = scratch(most)
            for k in range(outputs):
                y[k] = shares(w, at, z, k, p)

        @inner
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            # dy = sum_s p_s (a_s - y) dq_s, with q_s the logarithm of f_r d_l
            p = scratch(most)
            for k in range(outputs):
                y[k] = shares(w, at, z, k, p)
                for j in range(features):
                    by_z[k * features + j] = 0.0
                for i in range(ends[k + 1] - ends[k]):
                    s = ends[k] + i
                    pull = p[i] * (w[at + centre(k, s)] - y[k])
                    for j in range(features):
                        width = at + (2 * j + 1) * terms + antecedents[links[s, 0], j]
                        by_z[k * features + j] -= 2.0 * pull * apart(w, at, z, s, j) * math.exp(-w[width])

        @inner
        def weight_gradient(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            p = scratch(most)
            for k in range(outputs):
                y = shares(w, at, z, k, p)
                for i in range(ends[k + 1] - ends[k]):
                    s = ends[k] + i
                    own = centre(k, s)
                    pull = factors[k] * p[i] * (w[at + own] - y)
                    row[start + own] += factors[k] * p[i]
                    row[start + own + terms] += pull
                    for j in range(features):
                        place, d = 2 * j * terms + antecedents[links[s, 0], j], apart(w, at, z, s, j)
                        row[start + place] += 2.0 * pull * d * math.exp(-w[at + place + terms])
                        row[start + place + terms] += 2.0 * pull * d * d

        return value, jacobian, weight_gradient

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        terms, logarithms, found = self.terms, [], []
        for rule in self.rules:
            places = [2 * j * terms + term for j, term in enumerate(rule)]
            squares = [((value - w[at]) * exp(-w[at + terms])) ** 2 for value, at in zip(z, places, strict=True)]
            logarithms.append(-sum(squares))
        for k, links in enumerate(self.links):
            centres = [2 * (self.features + k) * terms + term for _, term in links]
            fed = [logarithms[rule] + w[at + terms] for (rule, _), at in zip(links, centres, strict=True)]
            largest = fed[0]
            for item in fed[1:]:
                largest = maximum(largest, item)
            parts = [exp(item - largest) for item in fed]
            found.append(sum(part * w[at] for part, at in zip(parts, centres, strict=True)) / sum(parts))
        return found
