"""The problem of the MPC as IPOPT solves it: slower, and the yardstick of tests and benchmarks."""

from __future__ import annotations

import casadi
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Plan, Status
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.symbolic import symbolic_step

Array = NDArray[np.float64]


class InteriorPointMpc:
    """Multiple shooting on the CasADi form, from the last solution moved on by one interval."""

    def __init__(self, system: System, problem: Problem, *, tolerance: float = 1e-6) -> None:
        self.system = system
        self.problem = problem
        self.horizon = problem.horizon
        self.period = problem.period
        states = len(system.states)
        x = casadi.SX.sym("x", states, problem.horizon + 1)
        u = casadi.SX.sym("u", problem.horizon)
        outside = casadi.SX.sym("s", states, problem.horizon)
        disturbance, previous = casadi.SX.sym("d"), casadi.SX.sym("u_previous")
        preview, initial = casadi.SX.sym("q", problem.horizon), casadi.SX.sym("x_0", states)
        step = symbolic_step(
            system,
            step=problem.period / problem.substeps,
            substeps=problem.substeps,
            smoothing=problem.smoothing,
        )
        outputs, changes, inputs = problem.weights
        difference = u - casadi.vertcat(previous, u[:-1])
        cost = casadi.dot(outputs, (x[system.measured[0], 1:].T - preview) ** 2)
        cost += casadi.dot(changes, difference**2) + casadi.dot(inputs, u**2)
        slack = casadi.vec(outside) / problem.output_scale
        cost += problem.soft_linear * casadi.sum1(slack) + problem.soft_quadratic * casadi.sumsqr(slack)
        ends = casadi.horzcat(*(step(x[:, i], u[i] + disturbance) for i in range(problem.horizon)))
        low, high = problem.bounds(states)
        bounded = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        rows = [
            (x[:, 0] - initial, np.zeros(states), np.zeros(states)),
            (casadi.vec(ends - x[:, 1:]), 0.0, 0.0),
            (difference, -problem.rate_limit, problem.rate_limit),
            *((x[a, 1:].T + outside[a, :].T, low[a], np.inf) for a in bounded),
            *((x[a, 1:].T - outside[a, :].T, -np.inf, high[a]) for a in bounded),
        ]
        self._rows = [np.concatenate([np.broadcast_to(row[k], row[0].numel()) for row in rows]) for k in (1, 2)]
        limits = np.full(problem.horizon, problem.input_limit)
        free = np.full(x.numel(), np.inf)
        idle = np.zeros(outside.numel())
        most = np.tile(np.where(np.isfinite(low) | np.isfinite(high), np.inf, 0.0), problem.horizon)
        self._bounds = [np.concatenate([-limits, -free, idle]), np.concatenate([limits, free, most])]
        statement = {
            "x": casadi.vertcat(u, casadi.vec(x), casadi.vec(outside)),
            "f": cost,
            "g": casadi.vertcat(*(row[0] for row in rows)),
            "p": casadi.vertcat(initial, disturbance, previous, preview),
        }
        options = {"print_level": 0, "sb": "yes", "max_iter": problem.max_iterations, "tol": tolerance, "mu_init": 1e-3}
        self._solver = casadi.nlpsol(
            "mpc",
            "ipopt",
            statement,
            {"expand": True, "print_time": False, "error_on_fail": False, "ipopt": options},
        )
        self.reset()

    def reset(self) -> None:
        """Forget the last solution."""
        self._inputs = np.zeros(self.horizon)
        self._states = np.zeros((self.horizon + 1, len(self.system.states)))
        self._cold = True

    def prepare(self, elapsed: float) -> None:
        """Move the plan on by one interval."""
        self._inputs = np.append(self._inputs[1:], self._inputs[-1])
        self._states = np.concatenate([self._states[1:], self._states[-1:]])

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`."""
        question = np.concatenate([state, disturbance, previous_input, preview])
        if np.all(np.isfinite(question)):
            if self._cold:
                self._inputs[:], self._states[:] = previous_input[0], state
            guess = np.concatenate([self._inputs, self._states.ravel(), np.zeros(self._states[1:].size)])
            bounds = dict(zip(("lbx", "ubx", "lbg", "ubg"), self._bounds + self._rows, strict=True))
            found = np.array(self._solver(x0=guess, p=question, **bounds)["x"]).ravel()
            if np.all(np.isfinite(found)):
                self._cold = False
                self._inputs = found[: self.horizon].copy()
                self._states = found[self.horizon :][: self._states.size].reshape(self._states.shape).copy()
                return self._planned(Status.SOLVED if self._solver.stats()["success"] else Status.NOT_CONVERGED)
        return self._planned(Status.FAILED)

    def _planned(self, status: Status) -> Plan:
        inputs = np.clip(self._inputs, -self.problem.input_limit, self.problem.input_limit)[:, None]
        return Plan(input=inputs[0].copy(), inputs=inputs, states=self._states[1:].copy(), status=status)
