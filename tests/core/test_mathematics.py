"""The mathematics of laws: values and derivatives as numpy has them, in compiled code and in CasADi."""

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
import pytest
from scipy.special import erf

from hybrid_sysid_ros.core import RungeKutta, Sampled, System, rollouts, step_with_jacobian
from hybrid_sysid_ros.core import mathematics as m
from hybrid_sysid_ros.core.symbolic import symbolic_output
from hybrid_sysid_ros.support.errors import UserError

WIDE, POSITIVE, INSIDE, ABOVE = (-2.3, 1.9), (0.1, 3.0), (-0.95, 0.95), (1.1, 4.0)

FUNCTIONS: dict[str, Any] = {  # of a law, as numpy has it, and ranges of its arguments
    "sin": (m.sin, np.sin, WIDE),
    "cos": (m.cos, np.cos, WIDE),
    "tan": (m.tan, np.tan, INSIDE),
    "asin": (m.asin, np.arcsin, INSIDE),
    "acos": (m.acos, np.arccos, INSIDE),
    "atan": (m.atan, np.arctan, WIDE),
    "atan2": (m.atan2, np.arctan2, WIDE, WIDE),
    "sinh": (m.sinh, np.sinh, WIDE),
    "cosh": (m.cosh, np.cosh, WIDE),
    "tanh": (m.tanh, np.tanh, WIDE),
    "asinh": (casadi.asinh, np.arcsinh, WIDE),
    "acosh": (casadi.acosh, np.arccosh, ABOVE),
    "atanh": (casadi.atanh, np.arctanh, INSIDE),
    "exp": (m.exp, np.exp, WIDE),
    "log": (m.log, np.log, POSITIVE),
    "log1p": (casadi.log1p, np.log1p, POSITIVE),
    "expm1": (casadi.expm1, np.expm1, WIDE),
    "sqrt": (m.sqrt, np.sqrt, POSITIVE),
    "erf": (casadi.erf, erf, WIDE),
    "hypot": (m.hypot, np.hypot, WIDE, WIDE),
    "sign": (m.sign, np.sign, WIDE),
    "absolute": (m.absolute, np.abs, WIDE),
    "minimum": (m.minimum, np.minimum, WIDE, WIDE),
    "maximum": (m.maximum, np.maximum, WIDE, WIDE),
    "floor": (casadi.floor, np.floor, WIDE),
    "ceil": (casadi.ceil, np.ceil, WIDE),
    "copysign": (casadi.copysign, np.copysign, WIDE, WIDE),
    "sum, difference, product, ratio": (
        lambda a, b: (a + b) * (a - b) / b,
        lambda a, b: (a + b) * (a - b) / b,
        WIDE,
        POSITIVE,
    ),
    "square": (lambda a: a**2, np.square, WIDE),
    "cube": (lambda a: a**3, lambda a: a**3, WIDE),
    "inverse": (lambda a: 1 / a, np.reciprocal, POSITIVE),
    "negative": (lambda a: -a, np.negative, WIDE),
    "twice": (lambda a: 2 * a, lambda a: 2 * a, WIDE),
    "root of a power": (lambda a: a**1.7, lambda a: a**1.7, POSITIVE),
    "power": (lambda a, b: a**b, np.power, POSITIVE, WIDE),
    "select": (lambda a, b: m.select(a > b, a * b, a - b), lambda a, b: np.where(a > b, a * b, a - b), WIDE, WIDE),
    "compare": (
        lambda a, b: m.select(casadi.logic_and(a <= b, casadi.logic_not(a == 0)), b, a),
        lambda a, b: np.where(a <= b, b, a),
        WIDE,
        WIDE,
    ),
    "either": (
        lambda a, b: m.select(casadi.logic_or(a < 0, b != b), a, b),
        lambda a, b: np.where(a < 0, a, b),
        WIDE,
        WIDE,
    ),
    "clip": (lambda a, b: m.clip(a, -0.5, b), lambda a, b: np.clip(a, -0.5, b), WIDE, POSITIVE),
    "saturate": (m.saturate, lambda a, b: np.clip(a, -b, b), WIDE, POSITIVE),
    "rounded saturate": (
        lambda a, b: m.saturate(a, b, 0.1),
        lambda a, b: (np.hypot(a + b, 0.1) - np.hypot(a - b, 0.1)) / 2,
        WIDE,
        POSITIVE,
    ),
}


@dataclass(frozen=True, kw_only=True)
class Calculator(System):
    """Its output is a function of two inputs, or of one."""

    states = ("x [1]",)
    inputs = ("a [1]", "b [1]")
    outputs = ("y [1]",)
    stepper = Sampled()
    function: Any
    arguments: int = 2

    def law(self, x, u):
        return x

    def output(self, x, u):
        # Away from the origin, where a law must be finite: some of these aren't.
        return (self.function(*[value + 0.5 for value in u][: self.arguments]),)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_and_its_derivative_is_numpys(name):
    ours, numpys, *ranges = FUNCTIONS[name]
    if name == "acosh":
        ours, numpys, ranges = (lambda a: casadi.acosh(a + 1.0)), (lambda a: np.arccosh(a + 1.0)), (POSITIVE,)
    system = Calculator(function=ours, arguments=len(ranges))
    exported = symbolic_output(system)
    random, h = np.random.default_rng(0), 1e-6
    for _ in range(50):
        point = np.array([random.uniform(low, high) for low, high in (*ranges, WIDE)[:2]])
        out, jacobian = step_with_jacobian(system, np.zeros(1), point - 0.5, step=1.0, output=True)
        given = point[: len(ranges)]
        assert out[0] == pytest.approx(numpys(*given), rel=1e-14, abs=1e-15)
        assert float(exported(np.zeros(1), point - 0.5)) == pytest.approx(numpys(*given), rel=1e-14, abs=1e-15)
        for column in range(len(ranges)):
            unit = h * np.eye(len(ranges))[column]
            if np.any(np.floor(given + unit) != np.floor(given - unit)):
                continue
            expected = (numpys(*(given + unit)) - numpys(*(given - unit))) / (2 * h)
            assert jacobian[0, 1 + column] == pytest.approx(expected, rel=1e-6, abs=1e-7)


def test_where_one_side_of_a_select_is_not_finite_the_other_counts():
    """Values and derivatives."""
    system = Calculator(function=lambda a: m.select(a > 0.0, m.sqrt(a), -m.log(1.0 - a)), arguments=1)
    for a, value, slope in ((4.0, 2.0, 0.25), (-1.0, -np.log(2.0), 0.5)):
        out, jacobian = step_with_jacobian(system, np.zeros(1), np.array([a - 0.5, 0.0]), step=1.0, output=True)
        assert (out[0], jacobian[0, 1]) == pytest.approx((value, slope), rel=1e-14)


@dataclass(frozen=True, kw_only=True)
class Strange(System):
    """With an operation that is no part of the mathematics of laws."""

    states = ("x [1]",)
    inputs = ("u [1]",)
    stepper = RungeKutta()

    def law(self, x, u):
        return (casadi.erfinv(0.1 * x[0]),)


def test_an_operation_that_can_not_be_compiled_is_named():
    with pytest.raises(UserError, match="OP_ERFINV"):
        rollouts(Strange(), np.array([[0, 0, 2, 0]]), np.zeros((1, 1)), np.zeros((1, 1)), step=0.1)
