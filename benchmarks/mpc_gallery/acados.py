"""acados on a case of the gallery, where acados and its Python interface are installed.

The same statement: the inputs before are states, so that changes and what counts at an interval's end are costs of
nodes; soft bounds have slacks; weights and parameters of a stage are parameters of its node. Solved from the same first
guess by several of acados' set-ups, of which the fastest that finds the optimum counts.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import casadi
import numpy as np

from benchmarks.acados_peer import FLAGS
from benchmarks.mpc_gallery.case import Case
from hybrid_sysid_ros.core.symbolic import symbolic_output, symbolic_step
from hybrid_sysid_ros.support.arrays import Array

NONE = 1e10
"""What acados takes for no bound."""
TOLERANCE = 1e-8


@dataclass(frozen=True, kw_only=True)
class SetUp:
    """Choices that acados leaves to its user."""

    hessian: str
    qp_solver: str
    globalization: str

    @property
    def name(self) -> str:
        return f"{self.hessian}, {self.qp_solver}, {self.globalization}".lower().replace("_", " ")


SET_UPS = [
    SetUp(hessian=hessian, qp_solver=solver, globalization=search)
    for hessian in ("GAUSS_NEWTON", "EXACT")
    for solver in ("PARTIAL_CONDENSING_HPIPM", "FULL_CONDENSING_DAQP")
    for search in ("FIXED_STEP", "MERIT_BACKTRACKING", "FUNNEL_L1PEN_LINESEARCH")
]


class AcadosCase:
    """A case as acados solves it, by a set-up. Raises ValueError for uneven intervals, which are not stated here."""

    def __init__(self, case: Case, set_up: SetUp) -> None:
        from acados_template import AcadosOcpSolver  # type: ignore[import-not-found]

        self._problem = case.problem.sized(case.system)
        if self._problem.intervals or self._problem.blocks:
            raise ValueError("uneven intervals are not stated here")
        self._case = case
        self._folder = tempfile.TemporaryDirectory()
        ocp = _statement(case, set_up)
        ocp.model.name = f"gallery_{os.getpid()}_{id(self)}"
        ocp.code_gen_options.code_export_directory = str(Path(self._folder.name) / "code")
        ocp.code_gen_options.ext_fun_compile_flags = FLAGS
        self._solver: Any = AcadosOcpSolver(ocp, verbose=False)

    def solve(self) -> tuple[Array, float, int]:
        """Inputs (N, m) from a cold start, the seconds around the call of the solver alone, and its steps."""
        solver, case, count = self._solver, self._case, self._problem.horizon
        solver.reset()
        state, _, previous, _ = case.instance
        start = np.concatenate([state, previous])
        for k, values in enumerate(_of_nodes(case)):
            solver.set(k, "p", values)
            solver.set(k, "x", start)
        for k in range(count):
            solver.set(k, "u", previous)
        began = perf_counter()
        solver.solve()
        seconds = perf_counter() - began
        inputs = np.array([solver.get(k, "u") for k in range(count)])
        return inputs, seconds, int(solver.get_stats("sqp_iter"))


def _of_nodes(case: Case) -> Iterator[Array]:
    """Parameters of each of the N + 1 nodes: weights and prices of its values, and the stage's parameters."""
    problem = case.problem.sized(case.system)
    weights = problem.weights
    rows = np.hstack([weights.outputs, weights.prices, problem.stage_values])
    yield np.concatenate([np.zeros(2 * weights.outputs.shape[1]), rows[0, 2 * weights.outputs.shape[1] :]])
    yield from rows


def _statement(case: Case, set_up: SetUp) -> Any:
    """The problem in acados' form."""
    from acados_template import AcadosModel, AcadosOcp

    system, problem = case.system, case.problem.sized(case.system)
    weights, n, m = problem.weights, len(system.states), len(system.inputs)
    values, p = weights.outputs.shape[1], len(system.outputs)
    z, u = casadi.SX.sym("z", n + m), casadi.SX.sym("u", m)
    given = casadi.SX.sym("p", 2 * values + len(problem.stage_parameters))
    x, before, stage = z[:n], z[n:], given[2 * values :]
    step = symbolic_step(
        system, step=problem.period / problem.substeps, substeps=problem.substeps, smoothing=problem.smoothing
    )
    output = symbolic_output(problem.outputs_of(system))
    drive = casadi.vertcat(before, stage, casadi.SX.zeros(m)) if problem.terms else before
    y, acting = output(x, drive), output(x, casadi.vertcat(u, stage, casadi.SX.zeros(m)) if problem.terms else u)
    model = AcadosModel()
    model.x, model.u, model.p = z, u, given
    model.disc_dyn_expr = casadi.vertcat(step(x, u), u)
    ocp = AcadosOcp()
    ocp.model, ocp.parameter_values = model, next(_of_nodes(case))
    ocp.solver_options.N_horizon, ocp.solver_options.tf = problem.horizon, problem.horizon * problem.period
    rates, own = np.sqrt(weights.rates[0]), np.sqrt(weights.inputs[0])
    error = y - casadi.vertcat(*np.broadcast_to(case.target, (p,)), casadi.SX.zeros(values - p))
    ended = casadi.vertcat(casadi.sqrt(given[:values]) * error, own * (before - weights.rest))
    changed = rates * (u - before)
    if set_up.hessian == "GAUSS_NEWTON" and not weights.prices.any():
        _least_squares(ocp, changed, ended)
    else:
        priced = casadi.dot(given[values : 2 * values], y)
        model.cost_expr_ext_cost_0 = casadi.sumsqr(changed)
        model.cost_expr_ext_cost = casadi.sumsqr(changed) + casadi.sumsqr(ended) + priced
        model.cost_expr_ext_cost_e = casadi.sumsqr(ended) + priced
        if set_up.hessian == "GAUSS_NEWTON":  # of the squares alone
            model.cost_expr_ext_cost_custom_hess_0 = _squares(changed, u, z)
            model.cost_expr_ext_cost_custom_hess = _squares(casadi.vertcat(changed, ended), u, z)
            model.cost_expr_ext_cost_custom_hess_e = _squares(ended, casadi.SX(0, 1), z)
        ocp.cost.cost_type_0 = ocp.cost.cost_type = ocp.cost.cost_type_e = "EXTERNAL"
    _bounds(ocp, case, y, acting)
    options = ocp.solver_options
    options.integrator_type, options.hessian_approx = "DISCRETE", set_up.hessian
    if set_up.hessian == "EXACT":
        options.regularize_method = "MIRROR"
    options.qp_solver, options.globalization = set_up.qp_solver, set_up.globalization
    options.nlp_solver_type, options.nlp_solver_max_iter = "SQP", problem.max_iterations
    options.nlp_solver_tol_stat = options.nlp_solver_tol_eq = TOLERANCE
    options.nlp_solver_tol_ineq = options.nlp_solver_tol_comp = TOLERANCE
    options.cost_scaling = np.ones(problem.horizon + 1)  # weights are per stage, not per second
    options.print_level = 0
    return ocp


def _squares(residual: Any, u: Any, z: Any) -> Any:
    jacobian = casadi.jacobian(residual, casadi.vertcat(u, z))
    return 2.0 * jacobian.T @ jacobian


def _least_squares(ocp: Any, changed: Any, ended: Any) -> None:
    """Squared residuals of the first, the inner and the last node; acados halves them."""
    for end, residual in (("_0", changed), ("", casadi.vertcat(changed, ended)), ("_e", ended)):
        setattr(ocp.model, f"cost_y_expr{end}", residual)
        setattr(ocp.cost, f"cost_type{end}", "NONLINEAR_LS")
        setattr(ocp.cost, f"W{end}", 2.0 * np.eye(residual.numel()))
        setattr(ocp.cost, f"yref{end}", np.zeros(residual.numel()))


def _bounds(ocp: Any, case: Case, y: Any, acting: Any) -> None:
    """Bounds of inputs and their changes, hard terms of inputs, and soft bounds of states and values."""
    system, problem = case.system, case.problem.sized(case.system)
    weights, n, m, p = problem.weights, len(system.states), len(system.inputs), len(system.outputs)
    held = ocp.constraints
    held.x0 = np.concatenate([case.instance[0], case.instance[2]])
    held.lbu, held.ubu, held.idxbu = np.array(problem.input_low), np.array(problem.input_high), np.arange(m)
    limits = np.array(problem.rate_limits)
    limited = np.flatnonzero(np.isfinite(limits))
    if len(limited):
        held.C, held.D = -np.eye(n + m)[n + limited], np.eye(m)[limited]
        held.lg, held.ug = -limits[limited], limits[limited]
    low, high = weights.low[-1], weights.high[-1]
    bounded = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
    linear, quadratic = [*weights.linear[bounded]], [*weights.quadratic[bounded]]
    for end in ("", "_e") if len(bounded) else ():
        setattr(held, f"idxbx{end}", bounded)
        setattr(held, f"lbx{end}", np.clip(low[bounded], -NONE, NONE))
        setattr(held, f"ubx{end}", np.clip(high[bounded], -NONE, NONE))
        setattr(held, f"idxsbx{end}", np.arange(len(bounded)))
    soft = [p + k for k, item in enumerate(problem.terms) if item.bounded and not item.hard]
    hard = [p + k for k, item in enumerate(problem.terms) if item.bounded and item.hard]
    forms: Mapping[str, tuple[list[Any], list[int]]] = {
        "_0": ([acting[k] for k in hard], hard),
        "": ([acting[k] for k in hard] + [y[k] for k in soft], hard + soft),
        "_e": ([y[k] for k in soft], soft),
    }
    for end, (found, rows) in forms.items():
        if found:
            setattr(ocp.model, f"con_h_expr{end}", casadi.vertcat(*found))
            setattr(held, f"lh{end}", np.clip([problem.terms[k - p].low for k in rows], -NONE, NONE))
            setattr(held, f"uh{end}", np.clip([problem.terms[k - p].high for k in rows], -NONE, NONE))
    for end, first in (("", len(hard)), ("_e", 0)):
        if soft:
            setattr(held, f"idxsh{end}", np.arange(first, first + len(soft)))
    linear += [weights.value_linear[k] for k in soft]
    quadratic += [weights.value_quadratic[k] for k in soft]
    for end in ("", "_e"):
        for side in "lu":
            setattr(ocp.cost, f"z{side}{end}", np.array(linear))
            setattr(ocp.cost, f"Z{side}{end}", 2.0 * np.array(quadratic))  # acados halves the squares
