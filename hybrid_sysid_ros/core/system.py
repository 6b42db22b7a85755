"""A system: named states, inputs and outputs, and the law of their motion, written once."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import FunctionType
from typing import Any, ClassVar

import numpy as np

from hybrid_sysid_ros.core.declaration import Variable, check_declaration, hidden_states, variables
from hybrid_sysid_ros.core.friction import Contact, Field
from hybrid_sysid_ros.core.mathematics import Scalar, rows
from hybrid_sysid_ros.core.parameters import Parameter, declared
from hybrid_sysid_ros.core.record_map import RecordMap, record_map
from hybrid_sysid_ros.core.sensing import Sensing
from hybrid_sysid_ros.core.steppers import ImplicitFriction, Sampled, StepContext, Stepper
from hybrid_sysid_ros.core.trace import kinematics_of
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Declared = Any
"""Read as tuple[Variable, ...]; a subclass writes texts such as "name [unit]"."""

_FORMER_HOOKS = {
    "shown": "reconstructible",
    "remembered": "delay_line",
    "hidden": "unobserved",
    "observed": "states_from_record",
}
"""Members that a system of an earlier edition overrides, and the field of the record map that replaces each."""


@dataclass(frozen=True, kw_only=True)
class System:
    """x' = law(x, u(t - delay)), y = output(x, u), with parameters as fields (:func:`~.parameters.bounded`).

    A subclass writes the law, and its states, inputs and outputs as texts such as "position [rad]". These become
    :class:`Variable` when the subclass is made; UserError is raised where they don't fit each other.
    """

    states: ClassVar[Declared] = ()
    """States of the law; hidden states of contacts, such as deflections of bristles, are added behind them."""
    inputs: ClassVar[Declared] = ()
    outputs: ClassVar[Declared] = ()
    """Measured variables: names of states, unless :meth:`output` computes them. Default: the first state."""
    features: ClassVar[Declared] = ()
    """Inputs of a network in the law, which :meth:`feature` computes. Default: all declared states and inputs."""
    closures: ClassVar[Declared] = ()
    """Quantities in the law that are known only roughly, such as coefficients. :meth:`closure` computes them, and a
    hybrid may correct them. Default: none."""
    contacts: ClassVar[tuple[Contact, ...]] = ()
    """Friction contacts, each on a velocity of its own."""
    stepper: ClassVar[Stepper] = ImplicitFriction()
    """The method that makes a time step of the law."""
    delays: ClassVar[Mapping[str, str | float]] = {}
    """Delays of inputs [s]: a number, or the name of a parameter."""
    operating_point: ClassVar[Mapping[str, float]] = {}
    """By name, the values from which states and inputs that are deviations are counted; 0 for all others."""
    doubtful_terms: ClassVar[tuple[str, ...]] = ()
    """Terms that fits leave out unless they are asked for: records hardly distinguish them from others."""

    _declared: ClassVar[tuple[Variable, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own, kind = cls.__dict__, cls.__name__
        for old, new in _FORMER_HOOKS.items():
            if isinstance(own.get(old), property | FunctionType):
                raise UserError(
                    f"{kind}: {old} is now {new} of record_map(); write record_map(self) that returns "
                    f"dataclasses.replace(super().record_map(), {new}=...)"
                )
        if "states" in own:
            cls._declared = variables(kind, "states", own["states"])
        if "inputs" in own:
            cls.inputs = variables(kind, "inputs", own["inputs"])
        known = cls._declared
        if not known:
            return  # a wrapper: its objects have the states of the wrapped system
        cls.states = (*known, *hidden_states(kind, cls.contacts, known))
        units = {item.name: item for item in cls.states}
        if "outputs" in own:
            found = variables(kind, "outputs", own["outputs"])
            cls.outputs = tuple(item if item.unit else units.get(item.name, item) for item in found)
        elif not cls.outputs:
            cls.outputs = known[:1]
        if "features" in own:
            units |= {item.name: item for item in cls.inputs}
            seen = variables(kind, "features", own["features"])
            cls.features = tuple(item if item.unit else units.get(item.name, item) for item in seen)
        if "closures" in own:
            cls.closures = variables(kind, "closures", own["closures"])
        check_declaration(cls)

    # ------------------------------------------------------------------ what a rig writes

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """Rates x' (states,) of the declared states from states and inputs, without the friction of contacts."""
        raise NotImplementedError

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """Readings of noise-free sensors, (outputs,); by default the states that have the outputs' names."""
        return [x[index] for index in self.measured]

    def feature(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """Inputs of a network (features,) from states and inputs: for an angle without limits, say, its sine."""
        return [*x[: len(self.declared_states)], *u]

    def closure(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        """The closures (closures,). Law and output must take them from here, so that a hybrid can add to them."""
        return ()

    def corrected(self, more: Callable[[Sequence[Scalar], Sequence[Scalar]], Sequence[Scalar]]) -> System:
        """A copy with ``more(x, u)`` (closures,) added to its closures."""
        changed, plain = copy.copy(self), self.closure

        def closure(x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
            return [value + added for value, added in zip(plain(x, u), more(x, u), strict=True)]

        object.__setattr__(changed, "closure", closure)
        return changed

    # ------------------------------------------------------------------ what steppers read

    def step_context(self) -> StepContext:
        """The law and its contacts for a stepper."""
        names = [item.name for item in self.states]
        return StepContext(rates=self._rates, contacts=self.contacts, field=self._field, names=names)

    def _rates(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return rows(self.law(x, u), len(self.declared_states), f"{type(self).__name__}: law(x, u)", "states")

    def _field(self, value: Field | tuple[Field, ...], x: Sequence[Scalar], u: Sequence[Scalar]) -> Any:
        """The value of a contact's field: a number, a parameter, a method, a function(system, x, u), or several."""
        if isinstance(value, tuple):
            return [self._field(item, x, u) for item in value]
        if not isinstance(value, str):
            return value(self, x, u) if callable(value) else value
        found = getattr(self, value)
        return found(x, u) if callable(found) else found

    # ------------------------------------------------------------------ what it is made of

    @cached_property
    def form(self) -> tuple[Any, ...]:
        """The key of the compiled code: the class and its fields without the values of parameters and weights."""
        parameters, weights = {item.name for item in self.parameters}, self.weights
        options = ((item.name, getattr(self, item.name)) for item in fields(self) if item.name not in parameters)
        return (type(self), *(_key(value) for _, value in options if value is not weights))

    @property
    def design(self) -> dict[str, Any] | None:
        """The learned part as plain data, from which :mod:`~hybrid_sysid_ros.models.structure` builds it again; None
        where nothing is learned.
        """
        return None

    @property
    def declared_states(self) -> tuple[Variable, ...]:
        """The states of the law, without the hidden states of contacts."""
        states: tuple[Variable, ...] = self.states
        return states[: len(states) - sum(len(contact.hidden) for contact in self.contacts)]

    @property
    def measured(self) -> tuple[int, ...]:
        """The index of the state that each output is. Raises UserError for an output that is no state."""
        names = [item.name for item in self.states]
        for item in self.outputs:
            if item.name not in names:
                raise UserError(f"{type(self).__name__}: output {item.name} is no state, and there is no output(x, u)")
        return tuple(names.index(item.name) for item in self.outputs)

    @property
    def plain_outputs(self) -> bool:
        """Whether every output is a state."""
        return type(self).output is System.output

    @property
    def sampling_time(self) -> float | None:
        """The only step [s] at which the system holds; None: it holds at any."""
        return None

    @property
    def kinematics(self) -> Mapping[int, int]:
        """Position state -> the velocity state that is its rate."""
        return kinematics_of(self)

    # ------------------------------------------------------------------ parameters and weights

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        kind: Any = type(self)
        return declared(kind)

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms that can be switched off, in the order of their parameters."""
        return tuple(dict.fromkeys(item.term for item in self.parameters if item.term))

    def without(self, terms: Collection[str]) -> tuple[System, tuple[str, ...]]:
        """The system with some terms switched off, and the names of the parameters that must not change then."""
        off = {item.name: item.neutral for item in self.parameters if item.term in terms}
        values = [off.get(item.name, value) for item, value in zip(self.parameters, self.values, strict=True)]
        return self.with_values(values), tuple(off)

    @property
    def values(self) -> Array:
        """Parameter values, (parameters,)."""
        return np.array([getattr(self, item.name) for item in self.parameters], dtype=float)

    @property
    def named(self) -> dict[str, float]:
        """Parameter values by name."""
        return dict(zip((item.name for item in self.parameters), self.values.tolist(), strict=True))

    def bound(self, values: Sequence[Scalar]) -> System:
        """A copy with other parameter values (parameters,), numbers or symbols."""
        changed = copy.copy(self)
        for item, value in zip(self.parameters, values, strict=True):
            object.__setattr__(changed, item.name, value)
        return changed

    def with_values(self, values: Sequence[float] | Array) -> System:
        """A copy with other parameter values, (parameters,)."""
        return self.bound([float(value) for value in values])

    @property
    def weights(self) -> Array:
        """Weights of the learned part, (weights,); empty where nothing is learned."""
        return np.zeros(0)

    def with_weights(self, weights: Array) -> System:
        if len(weights):
            raise UserError(f"{type(self).__name__} has no learned part, but {len(weights)} weights were given")
        return self

    def trained_on(self, low: Array, high: Array) -> System:
        """The same system, given the range of the states in its training data, low and high (states,)."""
        return self

    @property
    def input_delays(self) -> Array:
        """Delay of each input [s], (inputs,), with what all readings are late by as far as the system knows it."""
        values, late = self.named, 0.0 if self.sensing is None else self.sensing.common_lag
        found = (self.delays.get(item.name, 0.0) for item in self.inputs)
        return np.array([late + (values[value] if isinstance(value, str) else value) for value in found], dtype=float)

    @property
    def delay(self) -> float:
        """The longest input delay [s]."""
        return float(np.max(self.input_delays, initial=0.0))

    # ------------------------------------------------------------------ how it meets records, and checks

    @property
    def sensing(self) -> Sensing | None:
        """What the system knows of its sensors; None: a reading is the output at its moment."""
        return None

    def record_map(self) -> RecordMap:
        """How the states follow from a record: from outputs that are states, and from rates that are states too.

        A system whose records show more or less replaces fields: ``replace(super().record_map(), unobserved=[0])``.
        """
        return record_map(self.states, self.outputs, self.kinematics, len(self.declared_states))

    @property
    def outside(self) -> tuple[tuple[Parameter, float], ...]:
        """Parameters that are not finite or outside their bounds, with their values."""
        pairs = zip(self.parameters, self.values.tolist(), strict=True)
        return tuple((item, value) for item, value in pairs if not item.low <= value <= item.high)

    def check(self) -> None:
        """Raise UserError for a parameter that is not finite or outside its bounds."""
        for item, value in self.outside:
            raise UserError(
                f"{type(self).__name__}: parameter {item.name} = {value:g} {item.unit} is outside "
                f"[{item.low:g}, {item.high:g}]; correct it or fit again"
            )
        if not np.all(np.isfinite(self.weights)):
            raise UserError(f"{type(self).__name__}: a network weight is not finite; fit again")


@dataclass(frozen=True, kw_only=True)
class Recurrence(System):
    """x(k + 1) = law(x(k), u(k)), where u(k) is the mean input over the sample; it holds only at its own period."""

    stepper = Sampled()

    period: float = 0.05
    """Sampling time [s]."""

    @property
    def sampling_time(self) -> float:
        return self.period

    def fitted_again(self, records: Sequence[tuple[Array, Array]], iterations: int) -> System | None:
        """The map after some more iterations of a fit to other records, each inputs (samples, inputs) and outputs
        (samples, outputs); None where no fit can go on.
        """
        return None

    def record_map(self) -> RecordMap:
        """Every state is an output or the record's past."""
        return replace(super().record_map(), delay_line=range(len(self.states)), unobserved=())


def _key(value: Any) -> Any:
    """A hashable key of a field's value."""
    if isinstance(value, System):
        return value.form
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, Mapping):
        return tuple((name, _key(item)) for name, item in value.items())
    return tuple(map(_key, value)) if isinstance(value, (list, tuple)) else value
