"""acados on a problem of this project, where acados and its Python interface are installed.

Its usual fast set-up: discrete dynamics by CasADi's generated C code, Gauss-Newton SQP with full steps, condensed
quadratic programs by DAQP, everything compiled with -O3 -march=native -ffast-math.
"""

from __future__ import annotations

import importlib.util
import os
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control import ControlProblem, MpcSolution, Status
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.support.arrays import Array

FLAGS = "-O3 -march=native -ffast-math"
"""Of the compiler."""
QP_SOLVERS = "FULL_CONDENSING_DAQP", "PARTIAL_CONDENSING_HPIPM"


def installed() -> bool:
    """Whether acados_template and the libraries that it names are here."""
    return importlib.util.find_spec("acados_template") is not None and "ACADOS_SOURCE_DIR" in os.environ


def statement(
    system: System,
    problem: ControlProblem,
    folder: tempfile.TemporaryDirectory[str],
    *,
    qp_solver: str = QP_SOLVERS[0],
    flags: str = FLAGS,
) -> Any:
    """The problem in acados' form, its C code to be written into a folder. Raises ValueError for weights that change
    along the horizon, which are not stated here.
    """
    from acados_template import AcadosModel, AcadosOcp  # type: ignore[import-not-found]

    step = _step(system, problem)
    known, size = problem.sized(system).weights, len(system.states) + 1
    outputs, changes, inputs = (part[:, 0] for part in (known.outputs, known.rates, known.inputs))
    if any(changes != changes[-1]) or any(outputs != outputs[0]):
        raise ValueError("weights that change along the horizon are not stated here")
    x, u = casadi.SX.sym("x", size), casadi.SX.sym("u")
    model, ocp = AcadosModel(), AcadosOcp()
    model.name = f"peer_{os.getpid()}_{id(folder)}"
    model.x, model.u = x, u
    model.disc_dyn_expr = casadi.vertcat(step(x[:-1], u), u)
    ocp.model = model
    ocp.solver_options.N_horizon = problem.horizon
    ocp.solver_options.tf = problem.horizon * problem.period
    ocp.cost.cost_type = ocp.cost.cost_type_0 = "LINEAR_LS"
    ocp.cost.cost_type_e = "LINEAR_LS"
    rows = np.zeros((3, size))
    rows[0, system.measured[0]], rows[1, -1] = 1.0, -1.0
    moved = np.array([[0.0], [1.0], [1.0]])
    ocp.cost.Vx, ocp.cost.Vx_0, ocp.cost.Vu, ocp.cost.Vu_0 = rows, rows, moved, moved
    ocp.cost.Vx_e = rows[:1]
    # acados halves the squares; the first output is given and costs nothing.
    ocp.cost.W_0 = 2.0 * np.diag([0.0, changes[0], inputs[0]])
    ocp.cost.W = 2.0 * np.diag([outputs[0], changes[-1], inputs[-1]])
    ocp.cost.W_e = 2.0 * np.diag([outputs[-1]])
    ocp.cost.yref = ocp.cost.yref_0 = np.zeros(3)
    ocp.cost.yref_e = np.zeros(1)
    ocp.constraints.lbu, ocp.constraints.ubu = np.array(problem.input_low), np.array(problem.input_high)
    ocp.constraints.idxbu = np.array([0])
    ocp.constraints.x0 = np.zeros(size)
    options = ocp.solver_options
    options.integrator_type, options.hessian_approx = "DISCRETE", "GAUSS_NEWTON"
    options.qp_solver, options.qp_solver_warm_start = qp_solver, int("DAQP" in qp_solver)
    options.nlp_solver_type, options.nlp_solver_max_iter = "SQP", problem.max_iterations
    options.nlp_solver_tol_stat = options.nlp_solver_tol_eq = options.nlp_solver_tol_ineq = 1e-6
    # Weights are per stage, not per second.
    options.cost_scaling = np.ones(problem.horizon + 1)
    options.print_level = 0
    ocp.code_gen_options.code_export_directory = str(Path(folder.name) / "code")
    ocp.code_gen_options.ext_fun_compile_flags = flags
    return ocp


def _step(system: System, problem: ControlProblem) -> casadi.Function:
    return symbolic_step(
        system, step=problem.period / problem.substeps, substeps=problem.substeps, smoothing=problem.smoothing
    )


def follow(solver: Any, preview: Array) -> None:
    """Give a solver the references (N,) at the ends of its intervals."""
    for i, wanted in enumerate(preview[:-1], start=1):
        solver.set(i, "yref", np.array([wanted, 0.0, 0.0]))
    solver.set(len(preview), "yref", preview[-1:])


class AcadosMpc:
    """A controller on acados' solver; the input before is a state, for its change has a weight. No rate limit and no
    state bounds. In real time: preparation and feedback apart. times: [s] of its own calls, without what is set before
    and read after them.
    """

    def __init__(self, system: System, problem: ControlProblem, *, real_time: bool = False, flags: str = FLAGS) -> None:
        from acados_template import AcadosOcpSolver

        self.horizon, self.period, self.problem, self.real_time = problem.horizon, problem.period, problem, real_time
        self._states = len(system.states)
        self._folder = tempfile.TemporaryDirectory()
        ocp = statement(system, problem, self._folder, flags=flags)
        ocp.solver_options.nlp_solver_type = "SQP_RTI" if real_time else "SQP"
        self.solver: Any = AcadosOcpSolver(ocp, verbose=False)
        self._augmented = np.zeros(self._states + 1)
        self.times: dict[str, list[float]] = {"call": [], "prepare": []}
        self.reset()

    def reset(self) -> None:
        """Forget the last plan."""
        self.solver.reset()
        self._cold = True

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """The answer; only its first input is read."""
        solver, x = self.solver, self._augmented
        x[:-1], x[-1] = state, previous_input[0]
        if self._cold:
            for i in range(self.horizon + 1):
                solver.set(i, "x", x)
            self._cold = False
            if self.real_time:
                solver.options_set("rti_phase", 0)
        solver.set(0, "lbx", x)
        solver.set(0, "ubx", x)
        self._follow(preview)
        began = perf_counter()
        status = solver.solve()
        self.times["call"].append(perf_counter() - began)
        u = np.clip(solver.get(0, "u"), self.problem.input_low, self.problem.input_high)
        done = Status.ITERATED if self.real_time else (Status.SOLVED if status == 0 else Status.NOT_CONVERGED)
        return MpcSolution(input=u, inputs=u[None], states=np.zeros((0, self._states)), status=done)

    def prepare(self, elapsed: float) -> None:
        """Move the plan on by one interval; in real time linearise there."""
        solver, last = self.solver, self.horizon
        for i in range(last):
            solver.set(i, "x", solver.get(i + 1, "x"))
            if i + 1 < last:
                solver.set(i, "u", solver.get(i + 1, "u"))
        if self.real_time:
            # The preparation takes in the reference: the one to come, as far as it is known.
            self._follow(np.append(self._preview[1:], self._preview[-1]))
            solver.options_set("rti_phase", 1)
            began = perf_counter()
            solver.solve()
            self.times["prepare"].append(perf_counter() - began)
            solver.options_set("rti_phase", 2)

    def _follow(self, preview: Array) -> None:
        self._preview = preview.ravel()
        follow(self.solver, self._preview)


class AcadosBatch:
    """acados' solver of many problems at once: a solver for each instance, converged, in threads of OpenMP."""

    def __init__(self, system: System, problem: ControlProblem, size: int, *, qp_solver: str = QP_SOLVERS[0]) -> None:
        from acados_template import AcadosOcpBatchSolver

        self._step, self._states = _step(system, problem), len(system.states)
        self._folder = tempfile.TemporaryDirectory()
        ocp = statement(system, problem, self._folder, qp_solver=qp_solver)
        ocp.solver_options.with_batch_functionality = True
        self._batch: Any = AcadosOcpBatchSolver(ocp, size, verbose=False)

    def solve(self, rows: Array, starts: Array, threads: int) -> tuple[Array, NDArray[np.bool_], float]:
        """First inputs (size,) of instances [x, d, u_previous, q_1, ..., q_N] (size, n + 2 + N) without disturbances,
        from inputs (size, N, 1) and the states that they lead to; whether they are solved; and the seconds of the
        solver's own call, without what is set before.
        """
        batch, n, count = self._batch, self._states, starts.shape[1]
        batch.reset()
        x = np.column_stack([rows[:, :n], rows[:, n + 1]])
        for which in ("lbx", "ubx"):
            batch.constraints_set(0, which, x)
        for solver, preview in zip(batch.ocp_solvers, rows[:, n + 2 :], strict=True):
            follow(solver, preview)
        for i in range(count):
            u = starts[:, i]
            batch.set(i, "x", x)
            batch.set(i, "u", u)
            x = np.column_stack([np.array(self._step(x[:, :n].T, u.T)).T, u])
        batch.set(count, "x", x)
        batch.num_threads_in_batch_solve = threads
        began = perf_counter()
        batch.solve()
        seconds = perf_counter() - began
        return batch.get(0, "u")[:, 0], batch.status == 0, seconds
