"""Recurrences in lagged outputs and inputs."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np

from hybrid_sysid_ros.core import Parameter, Recurrence, Variable
from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.core.parameters import of_data
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

_Kind = TypeVar("_Kind", bound="Lagged")

REACH = 1.1
"""Outputs and inputs are limited to a band around the training data, so many times as wide as these. Beyond the data
the learned function means nothing, and a run hardly returns from a wider band. On held-out blocks of one rig's training
data the mean R2 of polynomials over 16 settings is .76 with 1.1 and .57 with 3."""


@dataclass(frozen=True, kw_only=True)
class Lagged(Recurrence):
    """y_k(t + 1) = Y_k f_k(r): a learned function of lags of all outputs and inputs.

        r = for each output (y(t), ..., y(t - ny + 1)) / Y, then for each input (u(t), ..., u(t - nu + 1)) / U

    u(t) is the mean input from sample t to the next. States are the lagged outputs, then the lagged inputs without the
    present ones. y(t + 1) and u are limited to :data:`REACH` times their range in the training data, so that no free
    run overflows. The scales Y, U and these ranges are fixed parameters; the learned weights have no unit.

    Leontaritis and Billings (1985), Input-output parametric models for non-linear systems, Int. J. Control 41(2).

    Raises UserError for lags, scales or ranges that don't fit each other.
    """

    KIND: ClassVar[str]
    """Name of the structure in errors."""
    LEARNED: ClassVar[str] = ""
    """Name of the field that holds the weights."""

    outputs: tuple[Variable, ...]  # type: ignore[misc]
    inputs: tuple[Variable, ...]  # type: ignore[misc]
    output_lags: int
    """ny; 0: f depends on inputs alone."""
    input_lags: int
    """nu."""
    scales: tuple[float, ...]
    """Y, U."""
    low: tuple[float, ...]
    """Lowest values of outputs and inputs in the training data."""
    high: tuple[float, ...]
    """Highest values of outputs and inputs in the training data."""

    def __post_init__(self) -> None:
        if self.output_lags < 0 or self.input_lags < 1:
            raise UserError(
                f"{self.KIND}: {self.output_lags} output lags and {self.input_lags} input lags; give 0 and 1 at least"
            )
        if not len(self.scales) == len(self.low) == len(self.high) == len(self.outputs) + len(self.inputs):
            raise UserError(f"{self.KIND}: scales or ranges are not those of {len(self.outputs)} outputs and inputs")
        past = [_lagged(item, range(self._kept)) for item in self.outputs]
        past += [_lagged(item, range(1, self.input_lags)) for item in self.inputs]
        object.__setattr__(self, "states", tuple(item for lagged in past for item in lagged))

    @abstractmethod
    def following(self, r: Sequence[Scalar]) -> Sequence[Scalar]:
        """The function f: the next outputs in their scales, (outputs,)."""

    @property
    def _kept(self) -> int:
        """Number of lags of an output among the states."""
        return max(self.output_lags, 1)

    @property
    def regressors(self) -> tuple[Variable, ...]:
        """The variables in r, with their units."""
        past = [_lagged(item, range(self.output_lags)) for item in self.outputs]
        past += [_lagged(item, range(self.input_lags)) for item in self.inputs]
        return tuple(item for lagged in past for item in lagged)

    @property
    def sizes(self) -> list[Any]:
        """The scale of each entry of r."""
        return [scale for scale, count in zip(self.scales, self._lag_counts, strict=True) for _ in range(count)]

    @property
    def _lag_counts(self) -> list[int]:
        """Number of entries in r of each output and input."""
        return [self.output_lags] * len(self.outputs) + [self.input_lags] * len(self.inputs)

    # ------------------------------------------------------------------ what it is made of

    @classmethod
    def of(cls: type[_Kind], design: Mapping[str, Any], weights: Array) -> _Kind:
        """The system of a :attr:`design` and weights (size,). Raises UserError where they don't fit."""
        variables = {name: tuple(Variable(**item) for item in design[name]) for name in ("outputs", "inputs")}
        plain = {name: _frozen(value) for name, value in design.items() if name not in variables}
        learned = tuple(float(value) for value in weights)
        return cls(**{**plain, **variables, cls.LEARNED: learned})

    @property
    def design(self) -> dict[str, Any]:
        """Everything except the weights as plain data, from which :meth:`of` builds the system again."""
        fields = dataclasses.asdict(self)
        del fields[self.LEARNED]
        return fields

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.output_lags, self.input_lags, len(self.outputs), len(self.inputs))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            of_data(f"{what}_{item.name}", item.unit, low=0.0 if what == "scale" else -1e12)
            for what in ("scale", "low", "high")
            for item in (*self.outputs, *self.inputs)
        )

    @property
    def values(self) -> Array:
        return np.array([*self.scales, *self.low, *self.high])

    def bound(self, values: Sequence[Scalar]) -> Lagged:
        n = len(self.scales)
        parts: dict[str, Any] = {
            name: tuple(values[i * n : (i + 1) * n]) for i, name in enumerate(("scales", "low", "high"))
        }
        return dataclasses.replace(self, **parts)

    @property
    def weights(self) -> Array:
        return np.array(getattr(self, self.LEARNED))

    def with_weights(self: _Kind, weights: Array) -> _Kind:
        learned: dict[str, Any] = {self.LEARNED: tuple(float(value) for value in weights)}
        return dataclasses.replace(self, **learned)

    # ------------------------------------------------------------------ the equation, and how it meets records

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        p, kept, nu = len(self.outputs), self._kept, self.input_lags
        bands = [self._band(i) for i in range(len(self.scales))]
        past = [list(x[k * kept : (k + 1) * kept]) for k in range(p)]
        for j, value in enumerate(u):
            begin = p * kept + j * (nu - 1)
            past.append([value, *x[begin : begin + nu - 1]])
        drives = [[clip(value, *band) for value in drive] for drive, band in zip(past[p:], bands[p:], strict=True)]
        seen = [*(lags[: self.output_lags] for lags in past[:p]), *drives]
        r = [value / scale for values, scale in zip(seen, self.scales, strict=True) for value in values]
        following = [
            [clip(scale * value, *band), *lags[: kept - 1]]
            for scale, value, band, lags in zip(self.scales, self.following(r), bands, past, strict=False)
        ]
        return [value for values in (*following, *(drive[: nu - 1] for drive in past[p:])) for value in values]

    def record_map(self) -> RecordMap:
        """The states are the record's own past.

        Before its first sample an output is extrapolated by its rate, and an input is the first one.
        """

        def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
            return np.column_stack([*self._past(outputs, rates, inputs)])

        return dataclasses.replace(super().record_map(), states_from_record=states_from_record)

    def _past(self, outputs: Array, rates: Array, inputs: Array) -> Iterator[Array]:
        p, samples, kept = len(self.outputs), len(outputs), self._kept
        back = np.arange(kept - 1, 0, -1) * self.period
        for k in range(p):
            measured = np.concatenate([outputs[0, k] - back * rates[0, k], outputs[:, k]])
            for lag in range(kept):
                yield measured[kept - 1 - lag :][:samples]
        for j in range(len(self.inputs)):
            drive = np.concatenate([np.full(self.input_lags, inputs[0, j]), inputs[:-1, j]])
            for lag in range(1, self.input_lags):
                yield drive[self.input_lags - lag :][:samples]

    def _band(self, channel: int) -> tuple[Any, Any]:
        low, high = self.low[channel], self.high[channel]
        more = 0.5 * (REACH - 1.0) * (high - low)
        return low - more, high + more


def _lagged(variable: Variable, lags: range) -> list[Variable]:
    """Lagged variables, with names such as drive_2 for the drive two samples ago; lag 0 has the plain name."""
    return [Variable(name=f"{variable.name}_{lag}" if lag else variable.name, unit=variable.unit) for lag in lags]


def _frozen(value: Any) -> Any:
    """A value of a file with lists as tuples."""
    return tuple(map(_frozen, value)) if isinstance(value, (list, tuple)) else value
