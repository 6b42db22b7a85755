"""A system whose inputs are off by a constant of each record's own, while it is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Parameter, System, Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.steppers import Motion
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Biased(System):
    """x' = f(x, u + S b),  b' = 0: a state b for each input, which no record shows and each begins with one of its own.

    As a fit's initial states are nuisances with priors, so is b, which counts in its prior deviation S.
    """

    physics: System
    """What is fitted."""
    spreads: tuple[float, ...]
    """S, prior deviations of the biases in the inputs' units, (inputs,)."""

    def __post_init__(self) -> None:
        for name in ("inputs", "outputs", "contacts", "stepper", "delays", "doubtful_terms"):
            object.__setattr__(self, name, getattr(self.physics, name))
        states, n = self.physics.states, self._at
        biases = (Variable(name=f"bias_{item.name}", unit="") for item in self.inputs)
        object.__setattr__(self, "states", (*states[:n], *biases, *states[n:]))

    @property
    def _at(self) -> int:
        """Where the biases stand among the states."""
        return len(self.physics.declared_states)

    def _place(self, state: int) -> int:
        """Of a state of the physics."""
        return state if state < self._at else state + len(self.inputs)

    def _own(self, x: Sequence[Scalar]) -> list[Scalar]:
        """The states of the physics."""
        return [*x[: self._at], *x[self._at + len(self.inputs) :]]

    def _acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        """The inputs with their biases."""
        return [value + spread * b for value, spread, b in zip(u, self.spreads, x[self._at :], strict=False)]

    def biases(self, nuisances: Mapping[str, Array]) -> dict[str, Array]:
        """Of each input in each record, (records,) in its unit, from what a fit added to the initial states."""
        return {
            item.name: spread * nuisances[f"bias_{item.name}"]
            for item, spread in zip(self.inputs, self.spreads, strict=True)
        }

    # ------------------------------------------------------------------ the equation

    def motion(self) -> Motion:
        """That of the physics under the inputs with their biases."""
        own, n = self.physics.motion(), self._at

        def rates(x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
            return [*own.rates(x[:n], self._acting(x, u)), *(0.0 for _ in u)]

        def field(value: Any, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
            return own.field(value, x[:n], self._acting(x, u))

        return replace(own, rates=rates, field=field, names=[item.name for item in self.states])

    @property
    def plain_outputs(self) -> bool:
        return self.physics.plain_outputs

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.physics.output(self._own(x), self._acting(x, u))

    # ------------------------------------------------------------------ what is that of the physics

    @property
    def form(self) -> tuple[Any, ...]:
        return type(self), self.physics.form, self.spreads

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.physics.parameters

    @property
    def values(self) -> Array:
        return self.physics.values

    def bound(self, values: Sequence[Scalar]) -> Biased:
        return replace(self, physics=self.physics.bound(values))

    @property
    def weights(self) -> Array:
        return self.physics.weights

    def with_weights(self, weights: Array) -> Biased:
        return replace(self, physics=self.physics.with_weights(weights))

    def trained_on(self, low: Array, high: Array) -> Biased:
        own = (np.array(self._own(values.tolist())) for values in (low, high))
        return replace(self, physics=self.physics.trained_on(*own))

    def check(self) -> None:
        self.physics.check()

    @property
    def shown(self) -> Mapping[int, tuple[int, bool]]:
        return {self._place(state): of for state, of in self.physics.shown.items()}

    @property
    def remembered(self) -> range:
        return self.physics.remembered

    @property
    def hidden(self) -> list[int]:
        return [*self.physics.hidden, *range(self._at, self._at + len(self.inputs))]

    def observed(self, outputs: Array, rates: Array, inputs: Array) -> Array:
        states = self.physics.observed(outputs, rates, inputs)
        none = np.zeros((len(states), len(self.inputs)))
        return np.concatenate([states[:, : self._at], none, states[:, self._at :]], axis=1)
