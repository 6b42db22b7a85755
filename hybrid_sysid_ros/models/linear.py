"""A linear system with a rig's variables, and with a textbook friction where the rig has contacts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from hybrid_sysid_ros.core import Bristles, Contact, Dry, Parameter, Sampled, System, Variable, Viscous
from hybrid_sysid_ros.core.declaration import integral_unit
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Friction = Literal["viscous", "stribeck", "dahl", "lugre"]

REACH = 20.0
"""Bounds of an entry, in units of the rate's scale divided by the scale of the variable that it multiplies."""

DOUBT = 0.5
"""Prior deviation of an entry that a state without measurement multiplies, relative to its initial value."""


@dataclass(frozen=True, kw_only=True)
class Linear(System):
    """x' = A x + B u + c, where each entry is a parameter.

    Positions follow their velocities, and outputs that are no states have rows y = C x + D u + d. The viscous part of
    each velocity v is integrated implicitly. Where the rig has a contact there is friction, per unit inertia:

        viscous   - D v
        stribeck  - D v - F(v) sgn v,  F(v) = Fc + Fe exp(-(v / vs)^2)
        dahl      - D v - s0 z,  z' = v (1 - s0 z / Fc sgn v)         Dahl (1968), with exponent 1
        lugre     - D v - s0 z - s1 z',  z' = v - |v| s0 z / F(v)     Canudas de Wit et al. (1995), IEEE TAC 40(3)

    Fc = coulomb, Fe = static_excess, vs = stribeck_speed, s0, s1 = bristle_stiffness, bristle_damping.
    Raises UserError for a friction on a rig without contacts, and for a rig that is a sampled map.
    """

    origin: System
    """The rig's system, which gives names, units, kinematics, contacts and delays, but no numbers."""
    friction: Friction = "viscous"
    straight: bool = False
    """Whether a rate depends only on the inputs and its own state, since a network learns the rest."""
    scales: tuple[float, ...] = ()
    """Magnitudes of the declared states, of the inputs and of the states' rates in training data; empty: all 1."""
    begin: Mapping[str, float] | None = None
    """Initial values of a fit by parameter; others begin at zero or at a value from their scales."""
    unshown: tuple[str, ...] = ()
    """States that no record shows; entries that they multiply have a prior."""

    def __post_init__(self) -> None:
        origin, carriers = self.origin, [contact.on for contact in self.origin.contacts]
        if isinstance(origin.stepper, Sampled):
            raise UserError(f"structure {self.friction}: {type(origin).__name__} is a map from sample to sample")
        if self.friction != "viscous" and not carriers:
            raise UserError(
                f"structure {self.friction}: {type(origin).__name__} has no contact that could carry friction; "
                "identify a linear structure, or write the rig's system with its contacts"
            )
        velocities = list(dict.fromkeys([*(self._names[i] for i in origin.kinematics.values()), *carriers]))
        contacts = [self._contact(name, rubs=name in carriers) for name in velocities]
        deflections = [state for contact in contacts for state in contact.hidden]
        object.__setattr__(self, "contacts", tuple(contacts))
        object.__setattr__(self, "states", (*origin.declared_states, *map(Variable.of, deflections)))
        for name in ("inputs", "outputs", "delays"):
            object.__setattr__(self, name, getattr(origin, name))
        for item in self.parameters:
            if item.name not in self.__dict__:
                object.__setattr__(self, item.name, item.start)

    @cached_property
    def _names(self) -> list[str]:
        return [item.name for item in self.origin.declared_states]

    @property
    def form(self) -> tuple[Any, ...]:
        origin = self.origin
        signature = (origin.declared_states, origin.inputs, origin.outputs, origin.plain_outputs)
        kinematics, delays = tuple(origin.kinematics.items()), tuple(origin.delays.items())
        carriers = tuple(contact.on for contact in origin.contacts)
        return (type(self), self.friction, self.straight, signature, kinematics, delays, carriers)

    @property
    def design(self) -> dict[str, Any]:
        begin = {item.name: item.start for item in self.parameters}
        return {"scales": list(self.scales), "begin": begin, "unshown": list(self.unshown)}

    def initialised(self, values: Mapping[str, float]) -> Linear:
        """The system with other values and initial values of some parameters, within their bounds."""
        known = {item.name: item for item in self.parameters}
        moved = {
            name: float(np.clip(float(f"{value:.4g}"), known[name].low, known[name].high))
            for name, value in values.items()
        }
        return replace(self, begin={**(self.begin or {}), **moved})

    @property
    def plain_outputs(self) -> bool:
        return self.origin.plain_outputs or all(item.name in self._names for item in self.origin.outputs)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self._parameters

    @cached_property
    def _parameters(self) -> tuple[Parameter, ...]:
        own = {item.name: item for item in self.origin.parameters}
        delays = [own[name] for name in self.delays.values() if isinstance(name, str)]
        return (*self._entries(), *self._frictions(), *dict.fromkeys(delays))

    # ------------------------------------------------------------------ entries

    @cached_property
    def _rows(self) -> list[tuple[str, str, float, bool]]:
        """Rows of entries: name of the state or output, unit and scale of the row's result, whether it is a rate."""
        origin, scales = self.origin, self._scales
        rates = [i for i in range(len(self._names)) if i not in origin.kinematics]
        rows = [(self._names[i], _rate(origin.states[i].unit), scales[f"{self._names[i]}'"], True) for i in rates]
        mapped = [] if origin.plain_outputs else [item for item in origin.outputs if item.name not in self._names]
        return rows + [(item.name, item.unit, 1.0, False) for item in mapped]

    @cached_property
    def _scales(self) -> dict[str, float]:
        keys = [*self._names, *(item.name for item in self.origin.inputs), *(f"{name}'" for name in self._names)]
        return dict(zip(keys, self.scales or (1.0,) * len(keys), strict=True))

    @cached_property
    def _columns(self) -> list[tuple[str, str]]:
        """Names and units of the variables that entries multiply."""
        return [(item.name, item.unit) for item in (*self.origin.declared_states, *self.origin.inputs)]

    def _has(self, row: str, column: str, rate: bool) -> bool:
        """Whether there is an entry: that of a velocity in its own row is its damping, and a straight row has few."""
        damped = any(contact.on == row for contact in self.contacts)
        if rate and row == column:
            return not damped
        return not (rate and self.straight and column in self._names)

    def _own(self, row: str) -> list[str]:
        """The state of a row and the position that it moves. Where they pull back in the rig's law at rest, a fit may
        not make them push away, since the bounded network could not stabilise that.
        """
        positions = [self._names[i] for i, j in self.origin.kinematics.items() if self._names[j] == row]
        return [row, *positions]

    def _entries(self) -> Iterator[Parameter]:
        scales, contacts = self._scales, {contact.on for contact in self.contacts}
        for row, unit, scale, rate in self._rows:
            for column, other in self._columns:
                if self._has(row, column, rate):
                    doubted = row in self.unshown or column in self.unshown
                    size = scale / scales[column]
                    name = f"{row}_per_{column}"
                    pulls = rate and column in self._own(row) and (self.begin or {}).get(name, 0.0) < 0.0
                    high = 0.0 if pulls else REACH
                    yield self._parameter(name, _ratio(unit, other), size, high=high, doubted=doubted)
            if not (rate and self.straight):
                yield self._parameter(f"{row}_offset", unit, scale, doubted=row in self.unshown)
            if rate and row in contacts:
                size = scale / scales[row]
                item = self._parameter(f"{row}_damping", "1/s", size, doubted=row in self.unshown, low=0.0)
                yield replace(item, description="Viscous friction.")

    def _frictions(self) -> Iterator[Parameter]:
        if self.friction == "viscous":
            return
        for name in dict.fromkeys(contact.on for contact in self.origin.contacts):
            index = self._names.index(name)
            force, speed = self._scales[f"{name}'"], self._scales[name]
            position = next((i for i, j in self.origin.kinematics.items() if j == index), None)
            way = self._scales[self._names[position]] if position is not None else speed
            unit = self.origin.states[index].unit
            yield self._parameter(
                f"{name}_coulomb",
                _rate(unit),
                force,
                start=0.05,
                low=0.0,
                high=5.0,
                description="Friction level at speed.",
            )
            if self.friction in ("stribeck", "lugre"):
                text = "Friction at rest above that level."
                yield self._parameter(
                    f"{name}_static_excess",
                    _rate(unit),
                    force,
                    start=0.01,
                    spread=0.025,
                    low=0.0,
                    high=5.0,
                    description=text,
                )
                text = "Speed at which the excess vanishes."
                yield self._parameter(
                    f"{name}_stribeck_speed",
                    unit,
                    speed,
                    start=0.08,
                    spread=0.08,
                    low=0.008,
                    high=3.0,
                    description=text,
                )
            if self.friction in ("dahl", "lugre"):
                yield self._parameter(
                    f"{name}_bristle_stiffness", "1/s^2", force / way, start=2.0, low=0.004, high=400.0
                )
            if self.friction == "lugre":
                yield self._parameter(
                    f"{name}_bristle_damping", "1/s", force / speed, start=0.03, spread=0.3, low=0.0, high=6.0
                )

    def _parameter(
        self,
        name: str,
        unit: str,
        size: float,
        *,
        start: float = 0.0,
        spread: float | None = None,
        low: float = -REACH,
        high: float = REACH,
        doubted: bool = False,
        description: str = "",
    ) -> Parameter:
        """A parameter whose values are scaled by a size."""
        begin = (self.begin or {}).get(name, start * size)
        doubt = DOUBT * max(abs(begin), 0.1 * size) if doubted else None
        return Parameter(
            name=name,
            unit=unit,
            low=low * size,
            high=high * size,
            start=begin,
            spread=doubt if spread is None else spread * size,
            description=description,
        )

    # ------------------------------------------------------------------ the system

    def _contact(self, name: str, *, rubs: bool) -> Contact:
        damping = f"{name}_damping"
        if not rubs or self.friction == "viscous":
            return Viscous(on=name, viscous=damping)
        if self.friction == "stribeck":
            return Dry(on=name, level=_level(name), viscous=damping)
        several = len(self.origin.contacts) > 1
        unit = integral_unit(self.origin.states[self._names.index(name)].unit)
        bristles = Bristles(
            on=name,
            level=f"{name}_coulomb" if self.friction == "dahl" else _level(name),
            stiffness=f"{name}_bristle_stiffness",
            viscous=damping,
            deflection=f"{name}_deflection [{unit}]" if several else f"deflection [{unit}]",
        )
        return replace(bristles, damping=f"{name}_bristle_damping") if self.friction == "lugre" else bristles

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        rates = dict(zip((row for row, *_ in self._rows), self._sums(x, u), strict=True))
        kinematics = self.origin.kinematics
        return [x[kinematics[i]] if i in kinematics else rates[name] for i, name in enumerate(self._names)]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        values = dict(zip((row for row, *_ in self._rows), self._sums(x, u), strict=True))
        states = dict(zip(self._names, x, strict=False))
        return [states[item.name] if item.name in states else values[item.name] for item in self.origin.outputs]

    def _sums(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Iterator[Scalar]:
        for row, _, _, rate in self._rows:
            values = zip(self._columns, [*x[: len(self._names)], *u], strict=True)
            terms = [getattr(self, f"{row}_per_{c}") * value for (c, _), value in values if self._has(row, c, rate)]
            yield sum(terms, getattr(self, f"{row}_offset", 0.0))

    def record_map(self) -> RecordMap:
        """The record map of the origin."""
        origin, declared = self.origin.record_map(), len(self._names)

        def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
            states = np.zeros((len(outputs), len(self.states)))
            states[:, :declared] = origin.states_from_record(outputs, rates, inputs)[:, :declared]
            return states

        return replace(super().record_map(), states_from_record=states_from_record)


def _level(name: str) -> Any:
    """The level of Stribeck's friction on a velocity."""

    def level(system: Any, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        coulomb, excess, speed = (
            getattr(system, f"{name}_{what}") for what in ("coulomb", "static_excess", "stribeck_speed")
        )
        return stribeck(x[system._names.index(name)], coulomb, coulomb + excess, speed)

    return level


def _rate(unit: str) -> str:
    """The unit of a rate of change."""
    return (
        f"{unit.removesuffix('/s')}/s^2" if unit.endswith("/s") else f"{unit}/s" if " " not in unit else f"({unit})/s"
    )


def _ratio(unit: str, other: str) -> str:
    """The unit of an entry: ``unit`` per ``other``."""
    if unit == other:
        return "1"
    for rate, short in ((f"{other}/s", "1/s"), (f"{other}/s^2", "1/s^2")):
        if unit == rate:
            return short
    if unit == _rate(other):
        return "1/s"
    return f"{unit}/({other})" if any(mark in other for mark in " /") else f"{unit}/{other}"
