"""Blocks: learned functions inside a law, opaque to its trace.

A law that is traced calls a block with its features and gets symbols for the outputs; the printed code then calls the
block's own compiled functions, and the chain rule joins their derivatives to those of the law.
"""

from __future__ import annotations

import dataclasses
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from types import FunctionType
from typing import Any

import casadi

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockCall:
    """One evaluation of a block within a trace."""

    block: Block
    features: casadi.SX
    """(features,)."""
    outputs: casadi.SX
    """Symbols (outputs,) that stand for what the block gives."""
    jacobian: casadi.SX
    """Symbols (outputs, features) that stand for its derivatives."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Calls:
    """What a trace has called so far."""

    weights: casadi.SX | None = None
    """Where blocks are to be written out: the weights (weights,) to do it with; None: they stay opaque."""
    made: list[BlockCall] = field(default_factory=list)


_current: ContextVar[Calls | None] = ContextVar("calls", default=None)


@contextmanager
def tracing(calls: Calls) -> Iterator[Calls]:
    """Collect the calls of blocks here."""
    token = _current.set(calls)
    try:
        yield calls
    finally:
        _current.reset(token)


Kernels = tuple[Callable[..., None], Callable[..., None], Callable[..., None]]
"""The kernels of a block.

value(w, at, z, y): y (outputs,) from the features z (features,) with the weights w[at:]. jacobian(w, at, z, y, by_z): y
and its derivatives (outputs x features) along rows. weight_gradient(w, at, z, factors, row, start): adds
sum_k factors[k] dy_k/dw to row[start:], one entry for each weight.
"""


class Block(ABC):
    """A learned function y = block(z; w) of features z, called inside a law. Subclasses are frozen dataclasses."""

    features: int
    outputs: int
    size: int
    """Number of its weights."""
    at: int = 0
    """Where they begin among the weights of the system."""

    @property
    def code(self) -> str:
        """A Python expression that makes the block again, wherever its weights begin. Subclasses are dataclasses."""
        block: Any = self
        names = (item.name for item in dataclasses.fields(block))
        given = ", ".join(f"{name}={getattr(self, name)!r}" for name in names if name != "at")
        return f"{type(self).__name__}({given})"

    @property
    def functions(self) -> Kernels:
        """The kernels for printed code. Those of another shape, and what they call, have another name: compiled code
        that is kept by several processes may number functions alike, and what is loaded later would then be linked to
        what was loaded before.
        """
        found, shape = self.kernels, re.sub("[^0-9A-Za-z]+", "_", self.code)
        waiting: list[Any] = list(found)
        while waiting:
            function = waiting.pop()
            if function.__closure__ is not None:
                function.__qualname__ = f"{function.__name__}_{shape}"
                inside = (cell.cell_contents for cell in function.__closure__)
                waiting += (item for item in inside if isinstance(item, FunctionType))
        return found

    @property
    @abstractmethod
    def kernels(self) -> Kernels:
        """Its functions for compiled code."""

    @abstractmethod
    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> Sequence[Scalar]:
        """The outputs written out, from features and its own weights (size,)."""

    def __call__(self, z: Sequence[Scalar]) -> list[Scalar]:
        """The outputs for features (features,), inside a law that is being traced."""
        calls = _current.get()
        if calls is None:
            raise RuntimeError("a block can be called in a law that is traced only")
        if len(z) != self.features:
            raise ValueError(f"a block of {self.features} features was given {len(z)}")
        if calls.weights is not None:
            weights: list[Any] = casadi.vertsplit(calls.weights[self.at : self.at + self.size])
            return list(self.symbolic(list(z), weights))
        number = len(calls.made)
        call = BlockCall(
            block=self,
            features=casadi.vertcat(*z),
            outputs=casadi.SX.sym(f"y{number}", self.outputs),
            jacobian=casadi.SX.sym(f"g{number}", self.outputs, self.features),
        )
        calls.made.append(call)
        return list(casadi.vertsplit(call.outputs))


@inner
def not_learnt(w: Any, at: int, z: Any, factors: Any, row: Any, start: int) -> None:
    """Derivatives by the weights of blocks that are trained by other means."""


def weighed(row: Any, values: Any, start: Any) -> Any:
    """Start + row . values, written out."""
    return sum((a * value for a, value in zip(row, values, strict=True)), start)
