"""Declarations of a class of systems: named variables, contacts and delays, checked when the class is made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core.friction import Contact
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A state, an input or an output."""

    name: str
    unit: str

    @classmethod
    def of(cls, text: str | Variable) -> Variable:
        """A variable from a text such as "position [rad]"; the unit may be left out."""
        if isinstance(text, Variable):
            return text
        name, _, rest = text.partition("[")
        return cls(name=name.strip(), unit=rest.strip().removesuffix("]").strip())

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def variables(kind: str, what: str, given: Iterable[str | Variable]) -> tuple[Variable, ...]:
    """The states, inputs or outputs that a class declares. Raises UserError for a bare text and for equal names."""
    if isinstance(given, str):
        raise UserError(f'{kind}: {what} are given as "{given}"; write ("{given}",)')
    found = tuple(Variable.of(text) for text in given)
    for name, count in Counter(item.name for item in found).items():
        if count > 1 or not name:
            raise UserError(f"{kind}: {count} {what} are called {name!r}; give each a name of its own")
    return found


def hidden_states(kind: str, contacts: Iterable[Contact], states: Iterable[Variable]) -> Iterator[Variable]:
    """The hidden states of the contacts. One that is declared without a unit is a displacement, or what the contact's
    ``hidden_power`` says, by the unit of its velocity.
    """
    units = {item.name: item.unit for item in states}
    for contact in contacts:
        rate = units.get(contact.on, "")
        for declared in contact.hidden:
            state = Variable.of(declared)
            if state.name in units:
                raise UserError(f"{kind}: two states are called {state.name!r}; name one where the contact is declared")
            units[state.name] = state.unit or (integral_unit(rate) if contact.hidden_power > 0 else rate_of(rate))
            yield Variable(name=state.name, unit=units[state.name])


def integral_unit(unit: str) -> str:
    """The unit of the integral of a rate over time."""
    return unit.removesuffix("/s") if unit.endswith("/s") else f"{unit} s".strip()


def rate_of(unit: str) -> str:
    """The unit of a variable's rate of change."""
    if unit.endswith("/s"):
        return f"{unit.removesuffix('/s')}/s^2"
    return f"{unit}/s" if " " not in unit else f"({unit})/s"


def check_declaration(kind: Any) -> None:
    """Raise UserError for contacts, delays and outputs of a class that don't fit its states, inputs and parameters."""
    called = kind.__name__
    states, inputs = ([item.name for item in group] for group in (kind.states, kind.inputs))
    for item in kind.closures:
        if item.name in states:
            raise UserError(f"{called}: {item.name} is a state and a closure; give the closure another name")
    velocities = [contact.on for contact in kind.contacts]
    for name in velocities:
        if name not in states:
            raise UserError(f"{called}: a contact is on {name!r}, which is no state; states are {', '.join(states)}")
        if velocities.count(name) > 1:
            raise UserError(f"{called}: two contacts are on {name}; join them into one")
    if velocities and not kind.stepper.takes_contacts:
        raise UserError(f"{called}: {type(kind.stepper).__name__} takes no contacts; use ImplicitFriction")
    for contact in kind.contacts:
        for field in contact.fields:
            declared = getattr(contact, field)
            for value in declared if isinstance(declared, tuple) else (declared,):
                if isinstance(value, str) and not hasattr(kind, value):
                    raise UserError(
                        f"{called}: the {field} of the contact on {contact.on} is {value!r}, which is neither a "
                        "parameter nor a method"
                    )
    parameters = _parameters(kind)
    for name, delay in kind.delays.items():
        if name not in inputs:
            raise UserError(f"{called}: a delay is of {name!r}, which is no input; inputs are {', '.join(inputs)}")
        if isinstance(delay, str) and delay not in parameters:
            raise UserError(f"{called}: the delay of {name} is {delay!r}, which is no parameter")
        if not isinstance(delay, str) and not 0.0 <= delay < float("inf"):
            raise UserError(f"{called}: the delay of {name} is {delay} s; it must be 0 or more")


def _parameters(kind: Any) -> set[str]:
    """Names of the parameters of a class that is still being made, so that it is no dataclass yet."""
    fields = {**getattr(kind, "__dataclass_fields__", {}), **vars(kind)}
    return {name for name, item in fields.items() if "parameter" in getattr(item, "metadata", ())}
