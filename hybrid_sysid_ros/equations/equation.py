"""An equation of motion, written once."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.equations.operations import Operations
from hybrid_sysid_ros.equations.parameters import Parameter, declared
from hybrid_sysid_ros.errors import UserError

Law = Callable[[Any, Any, Any, Any], tuple[Any, Any]]
"""law(x, u, p, w) -> (rates, (level, creep)): see :meth:`Equation.law`."""


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A state or an input: its name and unit."""

    name: str
    unit: str


@dataclass(frozen=True, kw_only=True)
class Equation(ABC):
    """x' = f(x, u(t - delay)) - friction, with its parameters as fields.

    One state may carry dry friction, a set-valued law that a right-hand side can't hold: the law returns its level F
    and its creep speed vc beside the smooth rates, and :mod:`~hybrid_sysid_ros.equations.integration` solves
    v' = f_v - F sat(v / vc) implicitly, so that the state sticks exactly where vc = 0.
    """

    states: ClassVar[tuple[Variable, ...]]
    inputs: ClassVar[tuple[Variable, ...]]
    outputs: ClassVar[tuple[int, ...]] = (0,)
    """States that are measured."""
    kinematics: ClassVar[Mapping[int, int]] = {}
    """Position state -> velocity state: positions move with the new velocity (semi-implicit Euler)."""
    friction_state: ClassVar[int | None] = None

    @abstractmethod
    def law(self, operations: Operations) -> Law:
        """The law in the form that ``operations`` make.

        Returns law(x, u, p, w): x (states,), u (inputs,), p the named parameters, w (weights,) of a network, giving
        the tuple of rates x' (states,) and the pair (friction level in units of the friction state per second, creep
        speed in units of the friction state).
        """

    @property
    def form(self) -> tuple[Any, ...]:
        """What decides the compiled code: the class and its options, not the values of its parameters."""
        return (type(self),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return declared(type(self))

    @property
    def values(self) -> NDArray[np.float64]:
        """Parameter values, (parameters,)."""
        return np.array([getattr(self, item.name) for item in self.parameters], dtype=float)

    def with_values(self, values: NDArray[np.float64]) -> Equation:
        """The same equation with other parameter values, (parameters,)."""
        named = {item.name: float(value) for item, value in zip(self.parameters, values, strict=True)}
        return dataclasses.replace(self, **named)

    @property
    def weights(self) -> NDArray[np.float64]:
        """Weights of the learned part, (weights,); empty where nothing is learned."""
        return np.zeros(0)

    def with_weights(self, weights: NDArray[np.float64]) -> Equation:
        if len(weights):
            raise UserError(f"{type(self).__name__} has no learned part, but {len(weights)} weights were given")
        return self

    def trained_on(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Equation:
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

    def check(self) -> None:
        """Raise UserError for a parameter that is not finite or outside its bounds."""
        for item, value in zip(self.parameters, self.values, strict=True):
            if not item.low <= value <= item.high:
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
