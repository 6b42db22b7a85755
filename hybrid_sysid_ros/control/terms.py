"""Terms of a stage's cost and constraints: formulas of states, inputs, outputs and parameters, and their derivatives.

A formula is text, so that a problem stays plain data in files, policies and nodes. It is traced like an output.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi

from hybrid_sysid_ros.core import mathematics
from hybrid_sysid_ros.core.declaration import Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.symbolic import symbolic_output
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.support import errors
from hybrid_sysid_ros.support.arrays import Numbers
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
class Term:
    """A scalar z of each stage, at the end of its interval, and its part of the problem:
    weight z^2 + price z, and low <= z <= high.

    weight and price are one number for all stages, or one for each. Raises UserError for values that make no sense.
    """

    name: str
    value: str
    """Formula of states, inputs without their disturbance, outputs, model's parameters and stage's parameters."""
    weight: Numbers = (0.0,)
    """[1/unit^2], at least 0."""
    price: Numbers = (0.0,)
    """[1/unit], of any sign."""
    low: float = -math.inf
    high: float = math.inf
    hard: bool = False
    """Whether the bounds hold without exception, which is for formulas of inputs alone; else they are soft."""
    soft_linear: float = 0.0
    """Price of a distance from the bounds [1/unit]."""
    soft_quadratic: float = 1e4
    """Price of a squared distance [1/unit^2]."""
    final: bool = False
    """Whether it counts at the end of the horizon alone."""

    def __post_init__(self) -> None:
        where = f"mpc: term {self.name}"
        if not isinstance(self.name, str) or not self.name.isidentifier() or not isinstance(self.value, str):
            raise UserError(f"{where}: a term needs a name and a formula, such as distance: {{value: hypot(x, y)}}")
        for key in ("weight", "price"):
            given = getattr(self, key)
            object.__setattr__(self, key, tuple(given) if isinstance(given, list | tuple) else (given,))
        for key in ("weight", "price", "low", "high", "soft_linear", "soft_quadratic"):
            found = getattr(self, key)
            values = found if isinstance(found, tuple) else (found,)
            whole = key in ("low", "high")
            if not all(_is_number(item) and (whole or math.isfinite(item)) for item in values) or not values:
                raise UserError(f"{where}: {key} is {found!r}; it needs a number")
            if key in ("weight", "soft_linear") and min(values) < 0.0:
                raise UserError(f"{where}: {key} is {min(values):g}; it must be at least 0")
        for key in ("hard", "final"):
            if not isinstance(getattr(self, key), bool):
                raise UserError(f"{where}: {key} is {getattr(self, key)!r}; it must be true or false")
        if not self.soft_quadratic > 0.0:
            raise UserError(f"{where}: soft_quadratic is {self.soft_quadratic:g}; it must be above 0")
        if not self.low < self.high:
            raise UserError(f"{where}: low {self.low:g} is not below high {self.high:g}")
        if not (self.bounded or any(self.weight) or any(self.price)):
            raise UserError(f"{where}: has no effect; give it a weight, a price or a bound")

    @property
    def bounded(self) -> bool:
        return math.isfinite(self.low) or math.isfinite(self.high)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and not math.isnan(value)


def terms_of(given: Any) -> tuple[Term, ...]:
    """Terms from terms, from mappings of their fields, or from a mapping {name: fields or formula}."""
    if isinstance(given, Mapping):
        fields = {name: {"value": item} if isinstance(item, str) else item for name, item in given.items()}
        given = [
            {"name": name, **item} if isinstance(item, Mapping) else {"name": name} for name, item in fields.items()
        ]
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise UserError(f"mpc: terms is {given!r}; give {{name: {{value: formula, price: 1.0}}}}")
    found = tuple(_term(item) for item in given)
    names = [term.name for term in found]
    if len(set(names)) < len(names):
        raise UserError(f"mpc: term {next(n for n in names if names.count(n) > 1)} is there twice")
    return found


def _term(item: Any) -> Term:
    if isinstance(item, Term):
        return item
    known = tuple(Term.__dataclass_fields__)
    if not isinstance(item, Mapping) or not {"name", "value"} <= {*item}:
        raise UserError(f"mpc: term {item!r} needs a name and a formula, such as distance: {{value: hypot(x, y)}}")
    if wrong := [str(key) for key in item if key not in known]:
        raise UserError(f"mpc: term {item['name']}: unknown key {wrong[0]!r}: {errors.known(wrong[0], known)}")
    return Term(**item)


@dataclass(frozen=True, kw_only=True)
class StageTerms(Wrapper):
    """A system whose outputs are followed by the terms of a stage, for compiled code and for CasADi.

    Its inputs are [u + d, parameters of the stage, d]. Raises UserError for a formula with an unknown name, and for a
    hard bound on a term that depends on states.
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
        known = {item.name: getattr(inner, item.name) for item in inner.parameters}
        known |= {item.name: value for item, value in zip(self.physics.outputs, y, strict=True)}
        known |= {item.name: value for item, value in zip(self.states, x, strict=True)}
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


def evaluated(text: str, known: Mapping[str, Scalar], where: str) -> Scalar:
    """The value of a formula of known names: numbers, + - * / **, and smooth functions. Raises UserError for others."""

    def value(node: ast.AST) -> Scalar:
        match node:
            case ast.Constant(value=number) if _is_number(number):
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
        raise UserError(f"{where}: {text!r} is no formula") from error
    except (ZeroDivisionError, OverflowError, TypeError, NotImplementedError) as error:
        raise UserError(f"{where}: {text!r} is not a number: {error}") from error


def with_terms(system: System, terms: Sequence[Term], stage: Sequence[str], *, curvature: bool = False) -> System:
    """The system with the terms behind its outputs; the system itself where there are none."""
    if not terms:
        return system
    pairs = tuple((term.name, term.value) for term in terms)
    return StageTerms(physics=system, formulas=pairs, stage=tuple(stage), curvature=curvature)


def check_terms(system: System, terms: Sequence[Term], stage: Sequence[str]) -> None:
    """Raise UserError for a formula that can't be evaluated, and for a hard bound on more than inputs."""
    if not terms:
        return
    output = symbolic_output(with_terms(system, terms, stage))
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", output.size1_in(1))
    values = output(x, u)[len(system.outputs) :]
    for row, term in enumerate(terms):
        if term.hard and casadi.depends_on(values[row], x):
            raise UserError(
                f"mpc: term {term.name}: a hard bound is for inputs alone, and {term.value} has states; make it soft"
            )
