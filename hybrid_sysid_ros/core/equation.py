"""An equation of motion, written once."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections import namedtuple
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.operations import Operations
from hybrid_sysid_ros.core.parameters import Parameter, declared
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]
Step = Callable[..., None]
"""step(x, u, p, w, h, following): see :meth:`Equation.advance`."""


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A state or an input: its name and unit."""

    name: str
    unit: str


@dataclass(frozen=True, kw_only=True)
class Equation(ABC):
    """x+ = step(x, u(t - delay)), with its parameters as fields.

    A :class:`~hybrid_sysid_ros.core.motion.Motion` writes the step as a law of continuous time, a
    :class:`~hybrid_sysid_ros.core.recurrence.Recurrence` as a map from one sample to the next.
    """

    states: ClassVar[tuple[Variable, ...]]
    inputs: ClassVar[tuple[Variable, ...]]
    outputs: ClassVar[tuple[int, ...]] = (0,)
    """States that are measured."""
    kinematics: ClassVar[Mapping[int, int]] = {}
    """Position state -> velocity state."""
    doubtful_terms: ClassVar[tuple[str, ...]] = ()
    """Terms that fits leave out unless asked for: records hardly tell them from others."""

    @abstractmethod
    def advance(self, operations: Operations) -> Step:
        """One step of time in the form that ``operations`` make.

        Returns step(x, u, p, w, h, following): x (states,), u (inputs,) over the step, p the named parameters, w
        (weights,) of what is learned, h the length of the step [s]; ``following`` (states,) receives the new state.
        """

    def observed(self, outputs: Array, rates: Array, inputs: Array) -> Array:
        """States (samples, states) as far as a record shows them: where simulations begin.

        outputs, rates (samples, outputs): measured ones and their rates of change; inputs (samples, inputs) since each
        sample. Here outputs and their rates where ``kinematics`` has them, the rest zero.
        """
        states = np.zeros((len(outputs), len(self.states)))
        for column, state in enumerate(self.outputs):
            states[:, state] = outputs[:, column]
            if state in self.kinematics:
                states[:, self.kinematics[state]] = rates[:, column]
        return states

    @property
    def form(self) -> tuple[Any, ...]:
        """What decides the compiled code: the class and its options, not the values of its parameters."""
        return (type(self),)

    @property
    def design(self) -> dict[str, Any] | None:
        """What a learned part is made of, as plain data from which :mod:`~hybrid_sysid_ros.models.structures` builds it
        again; None where nothing is learned.
        """
        return None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return declared(type(self))

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms that can be switched off, in the order of their parameters."""
        return tuple(dict.fromkeys(item.term for item in self.parameters if item.term))

    def without(self, terms: Collection[str]) -> tuple[Equation, tuple[str, ...]]:
        """The equation with terms switched off, and the names of the parameters that must stay as they are for that."""
        off = {item.name: item.neutral for item in self.parameters if item.term in terms}
        values = [off.get(item.name, value) for item, value in zip(self.parameters, self.values, strict=True)]
        return self.with_values(np.array(values, dtype=float)), tuple(off)

    @property
    def values(self) -> Array:
        """Parameter values, (parameters,)."""
        return np.array([getattr(self, item.name) for item in self.parameters], dtype=float)

    def with_values(self, values: Array) -> Equation:
        """The same equation with other parameter values, (parameters,)."""
        named = {item.name: float(value) for item, value in zip(self.parameters, values, strict=True)}
        return dataclasses.replace(self, **named)

    @property
    def weights(self) -> Array:
        """Weights of the learned part, (weights,); empty where nothing is learned."""
        return np.zeros(0)

    def with_weights(self, weights: Array) -> Equation:
        if len(weights):
            raise UserError(f"{type(self).__name__} has no learned part, but {len(weights)} weights were given")
        return self

    def trained_on(self, low: Array, high: Array) -> Equation:
        """The same equation told the range of the states in its training data, low and high (states,)."""
        return self

    @property
    def named(self) -> Any:
        """Parameter values as the named tuple that the law reads."""
        return parameter_tuple(tuple(item.name for item in self.parameters))(*(float(v) for v in self.values))

    @property
    def delay(self) -> float:
        """Input delay [s]: a parameter named input_delay, or none."""
        return float(getattr(self.named, "input_delay", 0.0))

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


@cache
def parameter_tuple(names: tuple[str, ...]) -> Any:
    """One named-tuple type for each set of names, so that compiled code is shared."""
    return namedtuple("Parameters", names)
