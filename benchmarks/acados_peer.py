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

from hybrid_sysid_ros.control import ControlProblem, MpcSolution, Status
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.support.arrays import Array

FLAGS = "-O3 -march=native -ffast-math"
"""Of the compiler."""


def installed() -> bool:
    """Whether acados_template and the libraries that it names are here."""
    return importlib.util.find_spec("acados_template") is not None and "ACADOS_SOURCE_DIR" in os.environ


class AcadosMpc:
    """A controller on acados' solver; the input before is a state, for its change has a weight. No rate limit and no
    state bounds. In real time: preparation and feedback apart. times: [s] of its own calls, without what is set before
    and read after them.
    """

    def __init__(self, system: System, problem: ControlProblem, *, real_time: bool = False, flags: str = FLAGS) -> None:
        from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver  # type: ignore[import-not-found]

        self.horizon, self.period, self.problem, self.real_time = problem.horizon, problem.period, problem, real_time
        self._states, self._output = len(system.states), system.measured[0]
        step = symbolic_step(
            system,
            step=problem.period / problem.substeps,
            substeps=problem.substeps,
            smoothing=problem.smoothing,
        )
        x, u = casadi.SX.sym("x", self._states + 1), casadi.SX.sym("u")
        model = AcadosModel()
        model.name = f"peer_{os.getpid()}_{id(self)}"
        model.x, model.u = x, u
        model.disc_dyn_expr = casadi.vertcat(step(x[:-1], u), u)
        ocp = AcadosOcp()
        ocp.model = model
        ocp.solver_options.N_horizon = problem.horizon
        ocp.solver_options.tf = problem.horizon * problem.period
        problem = problem.sized(system)
        outputs, changes, inputs = (
            part[:, 0] for part in (problem.weights.outputs, problem.weights.rates, problem.weights.inputs)
        )
        size = self._states + 1
        ocp.cost.cost_type = ocp.cost.cost_type_0 = "LINEAR_LS"
        ocp.cost.cost_type_e = "LINEAR_LS"
        rows = np.zeros((3, size))
        rows[0, self._output], rows[1, -1] = 1.0, -1.0
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
        options.qp_solver, options.qp_solver_warm_start = "FULL_CONDENSING_DAQP", 1
        options.nlp_solver_type = "SQP_RTI" if real_time else "SQP"
        options.nlp_solver_max_iter = problem.max_iterations
        options.nlp_solver_tol_stat = options.nlp_solver_tol_eq = options.nlp_solver_tol_ineq = 1e-6
        # Weights are per stage, not per second.
        options.cost_scaling = np.ones(problem.horizon + 1)
        options.print_level = 0
        self._folder = tempfile.TemporaryDirectory()
        ocp.code_gen_options.code_export_directory = str(Path(self._folder.name) / "code")
        ocp.code_gen_options.ext_fun_compile_flags = flags
        self.solver: Any = AcadosOcpSolver(ocp, verbose=False)
        if any(changes != changes[-1]) or any(outputs != outputs[0]):
            raise ValueError("weights that change along the horizon are not stated here")
        self._augmented = np.zeros(size)
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
        preview = preview.ravel()
        self._preview = preview
        for i in range(1, self.horizon):
            self.solver.set(i, "yref", np.array([preview[i - 1], 0.0, 0.0]))
        self.solver.set(self.horizon, "yref", preview[-1:])
