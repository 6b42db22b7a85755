"""Wrappers: systems around another one, their physics, with further states, other inputs or additions to its rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.declaration import Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.parameters import Parameter
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.core.sensing import Sensing
from hybrid_sysid_ros.core.steppers import Rates, StepContext
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Wrapper(System):
    """A system with the inputs, outputs, contacts, delays, parameters and weights of its physics.

    A subclass declares what differs: the states that it adds (:attr:`added_states`), the inputs of the physics
    (:meth:`acting`), and the rates (:meth:`rates`). Everything else comes from the physics.
    """

    physics: System
    """The wrapped system."""

    def __post_init__(self) -> None:
        for name in ("inputs", "outputs", "contacts", "stepper", "delays", "doubtful_terms"):
            object.__setattr__(self, name, getattr(self.physics, name))
        own, at = self.physics.states, self._physical
        object.__setattr__(self, "states", (*own[:at], *self.added_states, *own[at:]))

    # ------------------------------------------------------------------ what a subclass may say

    @property
    def added_states(self) -> tuple[Variable, ...]:
        """Further states, behind those of the physics."""
        return ()

    def acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """The inputs of the physics, from the states without deflections and the wrapper's inputs."""
        return u

    def rates(self, physics: Rates, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        """The rates of the states without deflections; ``physics`` computes those of the wrapped system."""
        return [*physics(x[: self._physical], self.acting(x, u)), *(0.0 for _ in self.added_states)]

    @property
    def _computed(self) -> System:
        """The physics that is evaluated, with corrections of closures if any."""
        return self.physics

    # ------------------------------------------------------------------ the equation

    @property
    def _physical(self) -> int:
        """Number of states in the law of the physics."""
        return len(self.physics.declared_states)

    def physical_states(self, x: Sequence[Any]) -> list[Any]:
        """The states of the physics, out of all states."""
        at = self._physical
        return [*x[:at], *x[at + len(self.states) - len(self.physics.states) :]]

    def step_context(self) -> StepContext:
        physics, at = self._computed.step_context(), self._physical

        def rates(x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
            return self.rates(physics.rates, x, u)

        def field(value: Any, x: Sequence[Scalar], u: Sequence[Scalar]) -> Any:
            return physics.field(value, x[:at], self.acting(x, u))

        return replace(physics, rates=rates, field=field, names=[item.name for item in self.states])

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self._computed.output(self.physical_states(x), self.acting(x, u))

    # ------------------------------------------------------------------ what is that of the physics

    @property
    def plain_outputs(self) -> bool:
        return self.physics.plain_outputs

    @property
    def sampling_time(self) -> float | None:
        return self.physics.sampling_time

    @property
    def sensing(self) -> Sensing | None:
        return self.physics.sensing

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.physics.parameters

    @property
    def values(self) -> Array:
        return self.physics.values

    def bound(self, values: Sequence[Scalar]) -> System:
        return replace(self, physics=self.physics.bound(values))

    @property
    def weights(self) -> Array:
        return self.physics.weights

    def with_weights(self, weights: Array) -> System:
        return replace(self, physics=self.physics.with_weights(weights))

    def trained_on(self, low: Array, high: Array) -> System:
        own = (np.array(self.physical_states(values.tolist())) for values in (low, high))
        return replace(self, physics=self.physics.trained_on(*own))

    def check(self) -> None:
        self.physics.check()
        super().check()

    def record_map(self) -> RecordMap:
        """The record map of the physics; further states begin at zero, and no record shows them."""
        own, at, more = self.physics.record_map(), self._physical, len(self.states) - len(self.physics.states)
        known = {index + (more if index >= at else 0): source for index, source in own.reconstructible.items()}
        rest = [i for i in range(len(self.declared_states)) if i not in known and i not in own.delay_line]

        def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
            states = own.states_from_record(outputs, rates, inputs)
            return np.insert(states, [at] * more, 0.0, axis=1)

        return replace(own, reconstructible=known, unobserved=rest, states_from_record=states_from_record)


@dataclass(frozen=True, kw_only=True)
class Stabilised(Wrapper):
    """x' = f(x, v - K x): a system with a stabiliser that acts at every moment. A slower controller gives its inputs
    v, in the units of u.
    """

    gains: tuple[tuple[float, ...], ...]
    """K (inputs, states)."""

    def acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        found = []
        for value, row in zip(u, self.gains, strict=True):
            for gain, state in zip(row, x, strict=False):  # a law gets the states without deflections
                value = value - gain * state if gain else value
            found.append(value)
        return found


@dataclass(frozen=True, kw_only=True)
class RateDisturbanceModel(Wrapper):
    """x' = f(x, u) + E o, o' = 0: a system with a constant, unknown disturbance o of some rates, as further states.

    An estimator and an MPC that include them remove steady errors (Pannocchia & Rawlings 2003, AIChE J. 49(2)).
    Raises UserError for a name that is no state, and for a system that is a map of samples.
    """

    on: tuple[str, ...]
    """Names of the states whose rates have a disturbance."""

    def __post_init__(self) -> None:
        known = [item.name for item in self.physics.declared_states]
        if missing := [name for name in self.on if name not in known]:
            raise UserError(f"offsets: {missing[0]} is no state; known are {', '.join(known)}")
        if self.physics.stepper.is_map:
            kind = type(self.physics).__name__
            raise UserError(
                f"offsets: {kind} is a map from sample to sample and has no rates: take a model of rates, or no offsets"
            )
        super().__post_init__()

    @property
    def added_states(self) -> tuple[Variable, ...]:
        units = {item.name: item.unit for item in self.physics.declared_states}
        return tuple(Variable(name=offset_of(name), unit=f"{units[name]}/s") for name in self.on)

    def rates(self, physics: Rates, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        found, names = super().rates(physics, x, u), [item.name for item in self.states]
        for name, offset in zip(self.on, x[self._physical :], strict=True):
            found[names.index(name)] = found[names.index(name)] + offset
        return found


def offset_of(state: str) -> str:
    """Name of the state that is the offset of the rate of ``state``."""
    return f"{state}_offset"


def feedback_of(system: System, stabiliser: Array) -> Array:
    """Gains K (inputs, outputs) of a stabiliser as gains of the states, (inputs, states).

    Raises UserError where an output that is fed back is no state.
    """
    names, found = [item.name for item in system.states], np.zeros((len(system.inputs), len(system.states)))
    for column, item in enumerate(system.outputs):
        if np.any(stabiliser[:, column]):
            if item.name not in names:
                raise UserError(f"stabiliser: {item.name} is fed back, but it is no state of {type(system).__name__}")
            found[:, names.index(item.name)] = stabiliser[:, column]
    return found
