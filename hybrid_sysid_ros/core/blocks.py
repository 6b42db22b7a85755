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
    """Symbols (outputs,) that stand for the block's outputs."""
    jacobian: casadi.SX
    """Symbols (outputs, features) that stand for its derivatives."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Calls:
    """What a trace has called so far."""

    weights: casadi.SX | None = None
    """Weights (weights,) with which blocks are written out as expressions; None: blocks stay opaque."""
    made: list[BlockCall] = field(default_factory=list)


_current: ContextVar[Calls | None] = ContextVar("calls", default=None)


@contextmanager
def tracing(calls: Calls) -> Iterator[Calls]:
    """Collect the calls of blocks that are made within this context."""
    token = _current.set(calls)
    try:
        yield calls
    finally:
        _current.reset(token)


Kernels = tuple[Callable[..., None], Callable[..., None], Callable[..., None]]
"""The kernels of a block.

value(w, at, z, y) computes y (outputs,) from the features z (features,) with the weights w[at:]. jacobian(w, at, z, y,
by_z) also computes the derivatives (outputs x features) along rows. weight_gradient(w, at, z, factors, row, start) adds
sum_k factors[k] dy_k/dw to row[start:], one entry for each weight.
"""


class Block(ABC):
    """A learned function y = block(z; w) of features z, called inside a law. Subclasses are frozen dataclasses."""

    features: int
    outputs: int
    size: int
    """Number of the block's weights."""
    at: int = 0
    """Index of its first weight among the weights of the system."""

    @property
    def code(self) -> str:
        """A Python expression that makes the block again, whatever the index of its first weight."""
        block: Any = self
        names = (item.name for item in dataclasses.fields(block))
        given = ", ".join(f"{name}={getattr(self, name)!r}" for name in names if name != "at")
        return f"{type(self).__name__}({given})"

    @property
    def functions(self) -> Kernels:
        """The kernels for printed code. Kernels of another shape, and the functions that they call, have other names:
        several processes may give cached functions the same number, and a function that is loaded later would then be
        linked to an earlier one.
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
        """The kernels for compiled code."""

    @abstractmethod
    def symbolic(self, z: Sequence[Scalar], w: Sequence[Scalar]) -> Sequence[Scalar]:
        """The outputs as expressions of the features (features,) and of the block's own weights (size,)."""

    def __call__(self, z: Sequence[Scalar]) -> list[Scalar]:
        """The outputs for features (features,), inside a traced law. Raises ValueError for other sizes."""
        calls = _current.get()
        if calls is None:
            raise RuntimeError("a block can be called only inside a law that is being traced")
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
    """Add nothing: the weight gradient of blocks that are trained by other means."""


def weighed(row: Any, values: Any, start: Any) -> Any:
    """Return start + row . values, written out."""
    return sum((a * value for a, value in zip(row, values, strict=True)), start)
