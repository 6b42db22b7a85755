"""Tightening: bounds moved in by the band of the prediction along the horizon, so that a share of loops keeps them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np
import scipy

from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System, step_with_jacobian
from hybrid_sysid_ros.extensions.shared import scenarios
from hybrid_sysid_ros.extensions.shared.steady_motion import jacobian_at, steady_motion
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers, refuse_unknown

LEAST = 1e-9
"""Least weight of an input in the feedback, relative to what its effect costs."""
LENGTH = 2
"""Length of each half of the loop along which bands are found, in horizons."""


@dataclass(frozen=True, kw_only=True)
class Tightening:
    """What is uncertain of a system with n states and m inputs, and the share of plans that is to keep a bound.

    Raises UserError for numbers that make no sense.
    """

    share: float
    """Of loops of which no period leaves a bound, from 0.5 to below 1."""
    between: Sequence[Sequence[float]]
    """Two outputs (p,) each in SI; bands are the widest along the steps from one to the other and back."""
    states: Numbers = (0.0,)
    """Deviations of the estimated states, (n,), anew in each period."""
    disturbance: Numbers = (0.0,)
    """Deviations of the estimated input disturbance, (m,), which stay."""
    parameters: float = 0.0
    """Relative deviation of each free physical parameter."""
    periods: int = 0
    """Length of these loops; 0: a horizon, which is the least."""
    feedback: bool = True
    """Whether bands are those of the closed loop: plans that follow answer deviations as the linear regulator of the
    problem does at rest. False: those of the open one, which are wider.
    """

    def __post_init__(self) -> None:
        for name in ("states", "disturbance", "parameters"):
            given = getattr(self, name)
            values = given if isinstance(given, list | tuple) else (given,)
            numbers(list(values), f"mpc: tightening: {name}", count=len(values))
            if not all(math.isfinite(value) and value >= 0.0 for value in values):
                raise UserError(f"mpc: tightening: {name} is {given}; it needs numbers not below 0")
        if not isinstance(self.share, int | float) or not 0.5 <= self.share < 1.0:
            raise UserError(f"mpc: tightening: share is {self.share!r}; it needs a number from 0.5 to below 1")
        if not isinstance(self.periods, int) or isinstance(self.periods, bool) or self.periods < 0:
            raise UserError(f"mpc: tightening: periods is {self.periods!r}; give a whole number, or 0 for a horizon")
        if not isinstance(self.feedback, bool):
            raise UserError(f"mpc: tightening: feedback is {self.feedback!r}; it must be true or false")

    @classmethod
    def declared(cls, given: Any) -> Tightening:
        """From a mapping of the fields. Raises UserError for another one."""
        known = tuple(cls.__dataclass_fields__)
        if not isinstance(given, Mapping) or not {"share", "between"} <= {*given}:
            raise UserError(f"mpc: tightening is {given!r}; give share and between, such as 0.999 and [[-1.0], [1.0]]")
        refuse_unknown(given, known, "mpc: tightening")
        return cls(**given)


def tightened(
    system: System, problem: ControlProblem, asked: Tightening, covariance: Array | None = None
) -> ControlProblem:
    """The problem with margins of its soft bounds on states and terms at each stage.

    The deviation of the states from a plan is followed with its covariance along a loop of the problem without margins,
    from each of its periods over a horizon. Its parts are the errors of the estimated states, and, staying as they are,
    those of the disturbance and the parameters. The margin of a stage is the largest deviation there times the quantile
    of (1 - share) / periods, since a loop keeps a bound in each of them (Boole). Hewing et al. (2020), Annual Review
    of Control, Robotics, and Autonomous Systems 3.

    covariance: of the free parameters, in their order, in place of ``asked.parameters``. Raises UserError where
    the regulator does not exist, and where a bound has nothing left.
    """
    problem, n, m = problem.sized(system), len(system.states), len(system.inputs)
    free = [k for k, item in enumerate(system.parameters) if not item.fixed]
    if covariance is None:
        covariance = np.diag((asked.parameters * system.values[free]) ** 2)
    if covariance.shape != (len(free), len(free)):
        raise UserError(f"mpc: tightening: the covariance has shape {covariance.shape} for {len(free)} free parameters")
    between = [np.array(numbers(each, "mpc: tightening: between", count=len(system.outputs))) for each in asked.between]
    if len(between) != 2 or not np.isfinite(between).all():
        raise UserError(f"mpc: tightening: between is {asked.between}; give two outputs, of finite numbers")
    estimated = np.diag(np.square(numbers(asked.states, "mpc: tightening: states", count=n)))
    offset = np.diag(np.square(numbers(asked.disturbance, "mpc: tightening: disturbance", count=m)))
    staying = np.block([[offset, np.zeros((m, len(free)))], [np.zeros((len(free), m)), covariance]])
    course = _course(system, problem, between)
    gains = _regulator(system, problem, between[0]) if asked.feedback else np.zeros((m, n))
    values = problem.outputs_of(system)
    periods = [(u, *_jacobians(system, problem, free, x, u)) for x, u in course]
    size = n + len(staying)
    widest = np.zeros((problem.horizon, n + len(problem.terms)))
    for begin in range(len(periods) - problem.horizon + 1):
        spread = np.zeros((size, size))
        spread[:n, :n], spread[n:, n:] = estimated, staying
        for i in range(problem.horizon):
            u, end, a, by_staying = periods[begin + i]
            by_state, by_input = _terms(system, values, problem, end, u, i)
            answer = gains * (i > 0)  # u = -K (x + e), with the error e of the estimate
            whole, by_error = np.eye(size), by_staying[:, :m] @ answer
            whole[:n, :n], whole[:n, n:] = a - by_error, by_staying
            term = by_state @ whole[:n]
            term[:, :n] -= by_input @ answer
            seen, errors = np.vstack([whole[:n], term]), np.vstack([by_error, by_state @ by_error + by_input @ answer])
            variances = _quadratic(seen, spread) + _quadratic(errors, estimated)
            widest[i] = np.maximum(widest[i], np.sqrt(np.maximum(variances, 0.0)))
            spread = whole @ spread @ whole.T
            spread[:n, :n] += by_error @ estimated @ by_error.T
    factor = NormalDist().inv_cdf(1.0 - (1.0 - asked.share) / max(asked.periods, problem.horizon))
    margins = [tuple(column) for column in (factor * widest.T).tolist()]
    terms = tuple(
        term if term.hard else replace(term, margin=margin)
        for term, margin in zip(problem.terms, margins[n:], strict=True)
    )
    return replace(problem, state_margins=tuple(margins[:n]), terms=terms).sized(system)


def declared(system: System, problem: ControlProblem, given: Any, model: Model | None) -> ControlProblem:
    """The problem as :func:`tightened`, by what the section mpc declares; without ``parameters`` there the covariance
    of a model counts.
    """
    asked = Tightening.declared(given)
    covariance = None if model is None or "parameters" in given else covariance_of(model, system)
    return tightened(system, problem, asked, covariance)


def covariance_of(model: Model, system: System) -> Array:
    """Covariance of the free parameters of a model's system, or of one about it, in their order; 0 of unknown ones."""
    free = [item.name for item in system.parameters if not item.fixed]
    found, known = np.zeros((len(free), len(free))), [name for name in model.names if name in free]
    own, to = [model.names.index(name) for name in known], [free.index(name) for name in known]
    found[np.ix_(to, to)] = model.covariance[np.ix_(own, own)]
    return found


def _course(system: System, problem: ControlProblem, between: Sequence[Array]) -> list[tuple[Array, Array]]:
    """States and inputs of each period of a loop without deviations, along a step and one back."""
    one, other = between
    periods = LENGTH * problem.horizon
    rest = steady_motion(system, problem, one)
    wanted = np.concatenate([np.tile(each, (periods, 1)) for each in (other, one)])
    wanted = np.concatenate([wanted, np.tile(one, (problem.horizon - 1, 1))])
    total, n, m = 2 * periods, len(system.states), len(system.inputs)
    none = {"states": (total, n), "inputs": (total, m)}
    steady = {"states": np.tile(rest.state, (total, 1)), "inputs": np.tile(rest.inputs, (total, 1))}
    scenario = scenarios.Scenario(
        plant=system,
        begins=np.arange(total) == 0,
        **steady,
        references=wanted,
        disturbances=np.zeros(none["inputs"]),
        pushes=np.zeros(none["states"]),
        state_errors=np.zeros(none["states"]),
        disturbance_errors=np.zeros(none["inputs"]),
        input_errors=np.zeros(none["inputs"]),
    )
    ((found, _),) = scenarios.run_many(ExactMpc(system, problem), [scenario], threads=1)
    return list(zip(found.states[:-1], found.inputs, strict=True))


def _quadratic(rows: Array, covariance: Array) -> Array:
    """Variance of each row's sum (rows,) of what has a covariance."""
    return np.einsum("ij,jk,ik->i", rows, covariance, rows)


def _jacobians(
    system: System, problem: ControlProblem, free: Sequence[int], x: Array, u: Array
) -> tuple[Array, Array, Array]:
    """The state at the end of a period, A, and derivatives [B, those by the free parameters]."""
    n, m, step = len(x), len(u), problem.period / problem.substeps
    a, rest = np.eye(n), np.zeros((n, m + len(free)))
    columns = slice(n, n + m + len(free))
    for _ in range(problem.substeps):
        x, jacobian = step_with_jacobian(system, x, u, step=step, smoothing=problem.smoothing, learn=bool(free))
        a, rest = jacobian[:, :n] @ a, jacobian[:, :n] @ rest + jacobian[:, columns]
    return x, a, rest


def _terms(
    system: System, values: System, problem: ControlProblem, x: Array, u: Array, stage: int
) -> tuple[Array, Array]:
    """Derivatives of the terms of a stage by the state (terms, n) and by the inputs (terms, m)."""
    n, m, step = len(x), len(u), problem.period / problem.substeps
    drive = np.concatenate([u, problem.stage_values[stage], np.zeros(m)])[: len(values.inputs)]
    _, jacobian = step_with_jacobian(values, x, drive, step=step, output=True)
    jacobian = jacobian[len(system.outputs) :]
    return jacobian[:, :n], jacobian[:, n : n + m]


def _regulator(system: System, problem: ControlProblem, outputs: Array) -> Array:
    """Gains K (m, n) of u = -K x about rest at outputs (p,), by the problem's weights."""
    rest = steady_motion(system, problem, outputs)
    _, a, b = _jacobians(system, problem, [], rest.state, rest.inputs)
    _, c, _ = jacobian_at(system, problem, rest.state, rest.inputs, output=True)
    weights = problem.stage_weights
    seen = c.T @ (weights.outputs[0, : len(c), None] * c)
    own = np.maximum(weights.rates[0] + weights.inputs[0], LEAST * max(float(np.abs(b.T @ seen @ b).max()), LEAST))
    try:
        stated = seen + LEAST * np.eye(len(a)) * max(np.abs(seen).max(), 1.0)
        cost = scipy.linalg.solve_discrete_are(a, b, stated, np.diag(own))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UserError(f"mpc: tightening: no regulator comes to rest there; give feedback: false ({error})") from error
    gains: Array = np.linalg.solve(np.diag(own) + b.T @ cost @ b, b.T @ cost @ a)
    return gains
