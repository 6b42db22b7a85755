"""Wrappers: systems about another system, held by a stabiliser, or with offsets of its rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.declaration import Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.parameters import Parameter
from hybrid_sysid_ros.core.steppers import Motion
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Wrapper(System):
    """A system with the inputs, outputs, parameters and weights of the one within it."""

    within: System

    def __post_init__(self) -> None:
        for name in ("states", "inputs", "outputs", "contacts", "stepper", "delays", "doubtful_terms"):
            object.__setattr__(self, name, getattr(self.within, name))

    @property
    def plain_outputs(self) -> bool:
        return self.within.plain_outputs

    @property
    def sampling_time(self) -> float | None:
        return self.within.sampling_time

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.within.parameters

    @property
    def values(self) -> Array:
        return self.within.values

    def bound(self, values: Sequence[Scalar]) -> System:
        return replace(self, within=self.within.bound(values))

    @property
    def weights(self) -> Array:
        return self.within.weights

    def with_weights(self, weights: Array) -> System:
        return replace(self, within=self.within.with_weights(weights))

    def motion(self) -> Motion:
        return self.within.motion()


@dataclass(frozen=True, kw_only=True)
class Stabilised(Wrapper):
    """x' = f(x, v - K x): a system whose stabiliser acts at every moment. Its inputs v are what a slower controller
    adds, in the units of u.
    """

    gains: tuple[tuple[float, ...], ...]
    """K (inputs, states)."""

    def acting(self, x: Sequence[Scalar], v: Sequence[Scalar]) -> list[Scalar]:
        """The inputs u of the system within."""
        found = []
        for value, row in zip(v, self.gains, strict=True):
            for gain, state in zip(row, x, strict=False):  # a law is given the states without deflections
                value = value - gain * state if gain else value
            found.append(value)
        return found

    def motion(self) -> Motion:
        """That of the system within, under what acts on it."""
        motion = self.within.motion()

        def rates(x: Sequence[Scalar], v: Sequence[Scalar]) -> Sequence[Scalar]:
            return motion.rates(x, self.acting(x, v))

        def field(value: Any, x: Sequence[Scalar], v: Sequence[Scalar]) -> Any:
            return motion.field(value, x, self.acting(x, v))

        return replace(motion, rates=rates, field=field)

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.within.output(x, self.acting(x, u))

    @property
    def shown(self) -> Mapping[int, tuple[int, bool]]:
        return self.within.shown


@dataclass(frozen=True, kw_only=True)
class Drifting(Wrapper):
    """x' = f(x, u) + E o, o' = 0: a system with an offset of some rates that nobody knows, as further states o.

    Estimated and planned with they take from a model's error what its inputs can't answer (Pannocchia & Rawlings 2003,
    AIChE J. 49(2)). Raises UserError for a name that is no state, and for a system that is a map of samples.
    """

    on: tuple[str, ...]
    """States whose rates have one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        known, n = self.within.states, len(self.within.declared_states)
        units = {item.name: item.unit for item in known[:n]}
        if missing := [name for name in self.on if name not in units]:
            raise UserError(f"offsets: {missing[0]} is no state; known are {', '.join(units)}")
        if self.within.stepper.is_map:
            kind = type(self.within).__name__
            raise UserError(
                f"offsets: {kind} is a map from sample to sample and has no rates: take a model of rates, or no offsets"
            )
        added = tuple(Variable(name=offset_of(name), unit=f"{units[name]}/s") for name in self.on)
        object.__setattr__(self, "states", (*known[:n], *added, *known[n:]))

    def motion(self) -> Motion:
        """That of the system within, with the offsets among its rates."""
        motion, n = self.within.motion(), len(self.within.declared_states)
        names = [item.name for item in self.states]
        places = [names.index(name) for name in self.on]

        def rates(x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
            found = list(motion.rates(x[:n], u))
            for place, offset in zip(places, x[n:], strict=True):
                found[place] = found[place] + offset
            return [*found, *[0.0] * len(self.on)]

        def field(value: Any, x: Sequence[Scalar], u: Sequence[Scalar]) -> Any:
            return motion.field(value, x[:n], u)

        return replace(motion, rates=rates, field=field, names=names)

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        n = len(self.within.declared_states)
        return self.within.output([*x[:n], *x[n + len(self.on) :]], u)

    @property
    def shown(self) -> Mapping[int, tuple[int, bool]]:
        n, more = len(self.within.declared_states), len(self.on)
        return {index + (more if index >= n else 0): told for index, told in self.within.shown.items()}


def offset_of(state: str) -> str:
    """Name of the state that is the offset of another one's rate."""
    return f"{state}_offset"


def feedback_of(system: System, stabiliser: Array) -> Array:
    """K (inputs, outputs) as gains of the states, (inputs, states).

    Raises UserError where an output that is fed back is no state.
    """
    names, found = [item.name for item in system.states], np.zeros((len(system.inputs), len(system.states)))
    for column, item in enumerate(system.outputs):
        if np.any(stabiliser[:, column]):
            if item.name not in names:
                raise UserError(f"stabiliser: {item.name} is fed back, but it is no state of {type(system).__name__}")
            found[:, names.index(item.name)] = stabiliser[:, column]
    return found
