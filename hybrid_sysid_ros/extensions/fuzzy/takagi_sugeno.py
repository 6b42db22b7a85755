"""Takagi-Sugeno models: a recurrence by rules with linear consequents."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Parameter
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.extensions.fuzzy.memberships import Memberships, unpacked
from hybrid_sysid_ros.extensions.shared.lagged import Lagged
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LARGEST = 500.0
"""Of a consequent's coefficient, which has no unit."""


@dataclass(frozen=True, kw_only=True)
class TakagiSugeno(Lagged):
    """y_k(t + 1) = Y_k sum_i h_i(z) (p_ki0 + sum_j p_kij r_j): if z is near c_i, then y_k is p_ki0 + p_ki r.

    h: memberships of the premise variables z, some of the entries of r, in the rules (:class:`~.memberships
    .Memberships`), which are what is learned as weights. The consequents p are parameters by name: a fit finds both,
    and an estimator may follow consequents, which is recursive least squares, for the model is linear in them.

    Takagi and Sugeno (1985), Fuzzy identification of systems and its applications to modeling and control, IEEE Trans.
    SMC 15(1). Raises UserError for premises or rules that don't fit the lags or the weights.
    """

    KIND = "takagi_sugeno"
    LEARNED = "premise_weights"

    premises: tuple[int, ...]
    """The entries of r that are z."""
    rules: int
    premise_weights: tuple[float, ...]
    """Centres and logarithms of widths, in the scales of r."""
    consequents: tuple[float, ...] = ()
    """p, for each output, rule by rule; zeros by default."""

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.regressors)
        if not self.premises or min(self.premises) < 0 or max(self.premises) >= count:
            raise UserError(f"{self.KIND}: premises {self.premises} are not among {count} regressors; fit again")
        if self.rules < 1 or len(self.premise_weights) != self.block.size:
            raise UserError(
                f"{self.KIND}: {len(self.premise_weights)} weights don't fit {self.rules} rules of "
                f"{len(self.premises)} premises; fit again"
            )
        size = len(self.outputs) * self.rules * (count + 1)
        object.__setattr__(self, "consequents", tuple(self.consequents) or (0.0,) * size)
        if len(self.consequents) != size:
            raise UserError(f"{self.KIND}: {len(self.consequents)} consequents for {size}; fit again")

    @property
    def block(self) -> Memberships:
        """H."""
        return Memberships(features=len(self.premises), rules=self.rules)

    @property
    def form(self) -> tuple[Any, ...]:
        return (*super().form, self.premises, self.rules)

    @property
    def design(self) -> dict[str, Any]:
        fields = super().design
        del fields["consequents"]  # they are parameters
        return fields

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        description = "Of a rule's consequent, output and regressor in their scales."
        names = ["offset", *(item.name for item in self.regressors)]
        consequents = (
            Parameter(
                name=f"{output.name}_rule_{rule + 1}_{name}",
                unit="",
                low=-LARGEST,
                high=LARGEST,
                start=0.0,
                learned=True,
                description=description,
            )
            for output in self.outputs
            for rule in range(self.rules)
            for name in names
        )
        return (*super().parameters, *consequents)

    @property
    def values(self) -> Array:
        return np.concatenate([super().values, self.consequents])

    def bound(self, values: Sequence[Scalar]) -> Lagged:
        first = 3 * len(self.scales)
        return dataclasses.replace(super().bound(values[:first]), consequents=tuple(values[first:]))  # type: ignore[call-arg]

    def following(self, r: Sequence[Scalar]) -> list[Scalar]:
        h, width = self.block([r[j] for j in self.premises]), len(r) + 1
        found: list[Scalar] = []
        for k in range(len(self.outputs)):
            total: Scalar = 0.0
            for i, membership in enumerate(h):
                at = (k * self.rules + i) * width
                offset, *jacobian = self.consequents[at : at + width]
                total = total + membership * sum((p * value for p, value in zip(jacobian, r, strict=True)), offset)
            found.append(total)
        return found

    # ------------------------------------------------------------------ in words

    @property
    def words(self) -> tuple[str, ...]:
        """The rules, in the units of outputs and inputs."""
        return tuple(self._words())

    @property
    def centres(self) -> Array:
        """Of the rules (rules, premises), in the units of the premise variables."""
        return unpacked(self.weights, self.rules)[0] * self._premise_sizes

    @property
    def widths(self) -> Array:
        """The same of their widths."""
        return unpacked(self.weights, self.rules)[1] * self._premise_sizes

    @property
    def premise_ranges(self) -> list[tuple[float, float]]:
        """Of each premise variable its range in the training data."""
        counts = self._lag_counts
        ends = [(a, b) for a, b, count in zip(self.low, self.high, counts, strict=True) for _ in range(count)]
        return [ends[j] for j in self.premises]

    @property
    def _premise_sizes(self) -> Array:
        return np.array(self.sizes)[list(self.premises)]

    def _words(self) -> Iterator[str]:
        centres, widths, names = self.centres, self.widths, self.regressors
        units = ["" if item.unit in ("", "1") else f" {item.unit}" for item in names]
        table = np.reshape(self.consequents, (len(self.outputs), self.rules, -1))
        for i in range(self.rules):
            near = (
                f"{names[j].name} is about {c:.3g}{units[j]} (width {b:.2g})"
                for j, c, b in zip(self.premises, centres[i], widths[i], strict=True)
            )
            then = (
                f"{output.name} becomes {scale * row[0]:.3g}"
                + "".join(
                    f" {'-' if p < 0.0 else '+'} {abs(scale * p / size):.3g} {item.name}"
                    for p, size, item in zip(row[1:], self.sizes, names, strict=True)
                )
                for output, scale, row in zip(self.outputs, self.scales, table[:, i], strict=False)
            )
            yield f"if {' and '.join(near)}, then {', '.join(then)}"
