"""Fuzzy rules with affine consequents (Takagi and Sugeno)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core.blocks import Block, Kernels, weighed
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.registers import scratch
from hybrid_sysid_ros.extensions.fuzzy.memberships import Memberships, add_weight_gradient, share_jacobian, shares


@dataclass(frozen=True, kw_only=True)
class AffineRules(Block):
    """y_k = sum_i h_i(z) (p_ki0 + p_ki z): if z is near c_i, then y_k is p_ki0 + p_ki z.

    h: :class:`~.memberships.Memberships`. Takagi and Sugeno (1985), IEEE Trans. SMC 15(1).

    Weights: those of h, then for each output and rule p_ki0, p_ki (features,).
    """

    features: int
    rules: int
    outputs: int = 1
    at: int = 0

    @property
    def premises(self) -> Memberships:
        """H."""
        return Memberships(features=self.features, rules=self.rules)

    @property
    def size(self) -> int:  # type: ignore[override]
        return self.premises.size + self.outputs * self.rules * (self.features + 1)

    @property
    def kernels(self) -> Kernels:
        rules, features, outputs, first = self.rules, self.features, self.outputs, self.premises.size
        width, entries = features + 1, rules * features

        @inner
        def consequent(w: Any, at: int, z: Any) -> float:
            """That of a rule whose numbers begin ``at``."""
            total = w[at]
            for j in range(features):
                total += w[at + 1 + j] * z[j]
            return total  # type: ignore[no-any-return]

        @inner
        def value(w: Any, at: int, z: Any, y: Any) -> None:
            h = scratch(rules)
            shares(w, at, z, rules, features, h)
            for k in range(outputs):
                y[k] = 0.0
                for i in range(rules):
                    y[k] += h[i] * consequent(w, at + first + (k * rules + i) * width, z)

        @inner
        def jacobian(w: Any, at: int, z: Any, y: Any, by_z: Any) -> None:
            h, h_by_z = scratch(rules), scratch(entries)
            share_jacobian(w, at, z, rules, features, h, h_by_z)
            for k in range(outputs):
                y[k] = 0.0
                for j in range(features):
                    by_z[k * features + j] = 0.0
                for i in range(rules):
                    place = at + first + (k * rules + i) * width
                    text = consequent(w, place, z)
                    y[k] += h[i] * text
                    for j in range(features):
                        by_z[k * features + j] += h_by_z[i * features + j] * text + h[i] * w[place + 1 + j]

        @inner
        def weight_gradient(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
            h, by_h = scratch(rules), scratch(rules)
            shares(w, at, z, rules, features, h)
            for i in range(rules):
                by_h[i] = 0.0
                for k in range(outputs):
                    place = first + (k * rules + i) * width
                    by_h[i] += factors[k] * consequent(w, at + place, z)
                    row[start + place] += factors[k] * h[i]
                    for j in range(features):
                        row[start + place + 1 + j] += factors[k] * h[i] * z[j]
            add_weight_gradient(w, at, z, rules, features, h, by_h, row, start)

        return value, jacobian, weight_gradient

    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> list[Scalar]:
        first, width = self.premises.size, self.features + 1
        h, found = self.premises.symbolic(z, w[:first]), []
        for k in range(self.outputs):
            rows = [w[at : at + width] for at in range(first + k * self.rules * width, len(w), width)]
            found.append(sum(share * weighed(row[1:], z, row[0]) for share, row in zip(h, rows, strict=False)))
        return found
