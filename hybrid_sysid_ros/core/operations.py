"""The handful of maths operations that a law may use, in each of the forms an equation takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba

from hybrid_sysid_ros.core import perceptron
from hybrid_sysid_ros.core.compilation import OPTIONS, inner
from hybrid_sysid_ros.core.perceptron import Perceptron

Operation = Callable[..., Any]


@dataclass(frozen=True, kw_only=True)
class Operations:
    """What a law is written in: ``law(operations)`` returns the law in the form these operations make.

    ``function(f)`` makes a part of a law callable from the law; ``select(condition, if_true, if_false)`` evaluates both
    branches; ``saturate(x, limit)`` is x within +-limit; ``perceptron(network)`` makes network(z, w) -> y_1 of a
    :class:`~hybrid_sysid_ros.core.perceptron.Perceptron`, z a tuple of its features.
    """

    function: Callable[[Operation], Operation]
    exp: Operation
    tanh: Operation
    sqrt: Operation
    absolute: Operation
    minimum: Operation
    maximum: Operation
    select: Operation
    saturate: Operation
    perceptron: Callable[[Perceptron], Operation]


@inner
def _exp(x: float) -> float:
    return math.exp(x)


@inner
def _tanh(x: float) -> float:
    return math.tanh(x)


@inner
def _sqrt(x: float) -> float:
    return math.sqrt(x)


@inner
def _absolute(x: float) -> float:
    return abs(x)


@inner
def _minimum(a: float, b: float) -> float:
    return a if a < b else b


@inner
def _maximum(a: float, b: float) -> float:
    return a if a > b else b


@inner
def _select(condition: bool, if_true: float, if_false: float) -> float:
    # np.where on scalars costs 130 ns; a compiled branch costs none.
    return if_true if condition else if_false


@inner
def _saturate(x: float, limit: float) -> float:
    return limit if x > limit else (-limit if x < -limit else x)


COMPILED = Operations(
    function=numba.njit(**OPTIONS),
    exp=_exp,
    tanh=_tanh,
    sqrt=_sqrt,
    absolute=_absolute,
    minimum=_minimum,
    maximum=_maximum,
    select=_select,
    saturate=_saturate,
    perceptron=perceptron.compiled,
)
"""Scalars under numba: simulation, fitting, filters, the plant. Dry friction is exact."""
