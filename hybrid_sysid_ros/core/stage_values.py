"""Values of a stage of a control problem: the outputs of a system, and formulas of its variables behind them."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi
import numpy as np

from hybrid_sysid_ros.core import mathematics
from hybrid_sysid_ros.core.declaration import Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.symbolic import symbolic_output
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.support import errors
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

_FUNCTIONS = {
    name: getattr(mathematics, name)
    for name in (
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
        *("sinh", "cosh", "tanh", "exp", "log", "sqrt", "hypot"),
    )
}
_OPERATORS: dict[type, Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_CORNERS = ("abs", "min", "max")


@dataclass(frozen=True, kw_only=True)
class StageValues(Wrapper):
    """A system whose outputs are followed by the terms of a stage, for compiled code and for CasADi.

    Its inputs are [u + d, parameters of the stage, d]. Raises UserError, when it is traced, for a formula with an
    unknown name, or that is none.
    """

    formulas: tuple[tuple[str, str], ...]
    """Name and formula of each."""
    stage: tuple[str, ...]
    """Names of the stage's parameters."""
    curvature: bool = False
    """Whether the outputs are the second derivatives of a sum of outputs and terms by states and inputs, along rows,
    whose factors are further inputs.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        plain = self.physics.inputs
        values = [item.name for item in self.physics.outputs] + [name for name, _ in self.formulas]
        more = [*self.stage, *(f"disturbance_of_{item.name}" for item in plain)]
        width = len(self.states) + len(plain)
        if self.curvature:
            more += [f"factor_of_{name}" for name in values]
            values = [f"second_{row}_{column}" for row in range(width) for column in range(width)]
        object.__setattr__(self, "inputs", (*plain, *(Variable(name=name, unit="") for name in more)))
        object.__setattr__(self, "outputs", tuple(Variable(name=name, unit="") for name in values))

    def acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return u[: len(self.physics.inputs)]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        values = self._values(x, u)
        if not self.curvature:
            return values
        factors = u[len(u) - len(values) :]
        by = casadi.vertcat(*x, *self.acting(x, u))
        total = casadi.dot(casadi.vertcat(*factors), casadi.vertcat(*values))
        return list(casadi.vertsplit(casadi.vec(casadi.densify(casadi.hessian(total, by)[0]))))

    def _values(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        m, q = len(self.physics.inputs), len(self.stage)
        y = list(super().output(x, u))
        inner: System = self.physics
        while isinstance(inner, Wrapper):
            inner = inner.physics
        known = {item.name: getattr(inner, item.name) for item in inner.parameters if hasattr(inner, item.name)}
        known |= {item.name: value for item, value in zip(self.states, x, strict=True)}
        known |= {item.name: value for item, value in zip(self.physics.outputs, y, strict=True)}
        commanded = zip(self.physics.inputs, u[:m], u[m + q : 2 * m + q], strict=True)
        known |= {item.name: value - offset for item, value, offset in commanded}
        for name, value in zip(self.stage, u[m : m + q], strict=True):
            if name in known:
                raise UserError(f"mpc: stage parameter {name} has the name of something else; rename it")
            known[name] = value
        return [*y, *(evaluated(text, known, f"mpc: term {name}") for name, text in self.formulas)]

    @property
    def plain_outputs(self) -> bool:
        return False

    @property
    def sensing(self) -> None:
        return None


def evaluated(text: str, known: Mapping[str, Scalar], where: str) -> Scalar:
    """The value of a formula of known names: numbers, + - * / **, and smooth functions. Raises UserError for others."""

    def value(node: ast.AST) -> Scalar:
        match node:
            case ast.Constant(value=float() | int() as number) if not isinstance(number, bool):
                return float(number)
            case ast.Name(id=name):
                if name == "pi":
                    return math.pi
                if name not in known:
                    raise UserError(f"{where}: {name} is unknown: {errors.known(name, (*known,))}")
                return known[name]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](value(left), value(right))
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](value(operand))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                if name in _CORNERS:
                    raise UserError(f"{where}: {name} is not smooth; take a term with a bound for each side, or sqrt")
                if name not in _FUNCTIONS:
                    raise UserError(f"{where}: function {name} is unknown: {errors.known(name, (*_FUNCTIONS,))}")
                return _FUNCTIONS[name](*(value(item) for item in arguments))
        raise UserError(
            f"{where}: {ast.unparse(node)} is no part of a formula; write numbers, names, + - * / ** and sin(x)"
        )

    try:
        return value(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError, RecursionError) as error:
        raise UserError(f"{where}: {errors.shown(text)} is no formula") from error
    except (ZeroDivisionError, OverflowError, TypeError, NotImplementedError) as error:
        raise UserError(f"{where}: {errors.shown(text)} is not a number: {error}") from error


def depend_on(system: System, inputs: int) -> list[tuple[bool, bool]]:
    """Whether each output of a system depends on its states, and on the first ``inputs`` inputs."""
    output = symbolic_output(system)
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.inputs))
    values = casadi.vertsplit(output(x, u))
    return [(casadi.depends_on(value, x), casadi.depends_on(value, u[:inputs])) for value in values]


class InputValues(NamedTuple):
    """Values of a system by its first inputs alone (inputs,), where states are 0."""

    function: casadi.Function
    """inputs -> values."""
    affine: list[bool]
    """Whether each is affine."""
    at: Array
    """(values,), where the inputs are 0."""
    by: Array
    """Their derivatives there, (values, inputs)."""


def values_by_inputs(output: casadi.Function, count: int, further: Sequence[float]) -> InputValues:
    """Values of a system's output map (:func:`~.symbolic.symbolic_output`) by its first ``count`` inputs. further: the
    inputs behind them; missing ones are 0.
    """
    u, behind = casadi.SX.sym("u", count), np.zeros(output.numel_in(1) - count)
    behind[: len(further)] = further
    found = casadi.densify(output(casadi.DM.zeros(output.numel_in(0)), casadi.vertcat(u, behind)))
    slopes = casadi.jacobian(found, u)
    values, by = casadi.Function("values", [u], [found, slopes])(np.zeros(count))
    affine = [not casadi.depends_on(slopes[k, :], u) for k in range(found.numel())]
    return InputValues(casadi.Function("values", [u], [found]), affine, np.array(values)[:, 0], np.array(by))
