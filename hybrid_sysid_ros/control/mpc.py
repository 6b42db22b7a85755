"""Exact model predictive control: multiple shooting on the smooth form, solved by IPOPT."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Plan, Status
from hybrid_sysid_ros.equations import Equation, symbolic_step
from hybrid_sysid_ros.errors import UserError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What is minimised: sum_{i=1}^{N} output_weight ((y_i - q_i) / output_scale)^2
    + sum_{i=0}^{N-1} rate_weight (u_i - u_{i-1})^2 over |u_i| <= input_limit, x_{i+1} = step(x_i, u_i + d).

    horizon: N. period: length of one interval [s]. substeps: integration steps in it. output_scale: the unit that the
    output is weighed in [rad] (a volt of the sensor). smoothing: of stick-slip [rad/s]. max_iterations: of the solver.
    """

    horizon: int
    period: float
    substeps: int
    output_weight: float
    rate_weight: float
    input_limit: float
    output_scale: float
    smoothing: float
    max_iterations: int

    def __post_init__(self) -> None:
        for name in ("horizon", "period", "substeps", "output_weight", "input_limit", "output_scale", "max_iterations"):
            if not getattr(self, name) > 0:
                raise UserError(f"mpc: {name} is {getattr(self, name)}; it must be above 0")
        if not (self.rate_weight >= 0 and self.smoothing >= 0):
            raise UserError("mpc: rate_weight and smoothing must not be negative")


class ExactMpc:
    """Solves the problem at every call, from the shifted last solution.

    Offset-free: d is the estimated input disturbance, so the prediction meets the measurement at rest (Pannocchia &
    Rawlings 2003, AIChE J. 49(2)).
    """

    def __init__(self, equation: Equation, problem: Problem) -> None:
        if len(equation.inputs) != 1:
            raise UserError(f"{type(equation).__name__}: the MPC takes models of one input")
        self.equation = equation
        self.problem = problem
        self.horizon = problem.horizon
        self.period = problem.period
        self._states = len(equation.states)
        self._solver = self._build()
        count = (self._states + 1) * problem.horizon
        self._lower = np.full(count, -np.inf)
        self._upper = np.full(count, np.inf)
        self._lower[:: self._states + 1] = -problem.input_limit
        self._upper[:: self._states + 1] = problem.input_limit
        self.reset()

    def _build(self) -> casadi.Function:
        problem, states = self.problem, self._states
        step = symbolic_step(
            self.equation,
            step=problem.period / problem.substeps,
            substeps=problem.substeps,
            smoothing=problem.smoothing,
        )
        x = initial = casadi.SX.sym("x0", states)
        disturbance = casadi.SX.sym("d")
        previous = last = casadi.SX.sym("u_previous")
        preview = casadi.SX.sym("q", problem.horizon)
        variables, defects, cost = [], [], casadi.SX(0)
        output = self.equation.outputs[0]
        for i in range(problem.horizon):
            u = casadi.SX.sym(f"u{i}")
            following = casadi.SX.sym(f"x{i + 1}", states)
            variables += [u, following]
            defects.append(step(x, u + disturbance) - following)
            cost += problem.output_weight * ((following[output] - preview[i]) / problem.output_scale) ** 2
            cost += problem.rate_weight * (u - last) ** 2
            x, last = following, u
        statement = {
            "x": casadi.vertcat(*variables),
            "f": cost,
            "g": casadi.vertcat(*defects),
            "p": casadi.vertcat(initial, disturbance, previous, preview),
        }
        options = {
            "expand": True,
            "print_time": False,
            "error_on_fail": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": problem.max_iterations,
                "tol": 1e-6,
                "mu_init": 1e-3,
                "warm_start_init_point": "yes",
            },
        }
        return casadi.nlpsol("mpc", "ipopt", statement, options)

    def reset(self) -> None:
        """Forget the last solution."""
        self._guess = np.zeros((self._states + 1) * self.problem.horizon)
        self._cold = True

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`.

        Where something is not a number, or the solver finds none, the plan is FAILED: the rest of the last one, or the
        previous input (zero if that is no number either) where there is none.
        """
        width, limit = self._states + 1, self.problem.input_limit
        question = np.concatenate([state, disturbance, previous_input, preview])
        valid = bool(np.all(np.isfinite(question)))
        if self._cold:
            held = previous_input[0] if np.isfinite(previous_input[0]) else 0.0
            self._guess.reshape(-1, width)[:, 0] = np.clip(held, -limit, limit)
            self._guess.reshape(-1, width)[:, 1:] = state if valid else 0.0
        if not valid:
            plan = self._planned(self._guess, Status.FAILED)
            return replace(plan, states=plan.states[:0]) if self._cold else plan
        solution = self._solver(
            x0=self._guess,
            p=question,
            lbx=self._lower,
            ubx=self._upper,
            lbg=0.0,
            ubg=0.0,
        )
        found = np.array(solution["x"]).ravel()
        self._cold = not np.all(np.isfinite(found))
        if self._cold:
            return self._planned(self._guess, Status.FAILED)
        return self._planned(found, Status.SOLVED if self._solver.stats()["success"] else Status.NOT_CONVERGED)

    def _planned(self, found: Array, status: Status) -> Plan:
        """The plan in a solution, which shifted is the guess of the next one."""
        table = found.reshape(-1, self._states + 1)
        inputs = np.clip(table[:, :1], -self.problem.input_limit, self.problem.input_limit)
        self._guess = np.concatenate([table[1:], table[-1:]]).ravel()
        return Plan(input=inputs[0].copy(), inputs=inputs, states=table[:, 1:].copy(), status=status)
