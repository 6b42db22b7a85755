"""The problem of the MPC as IPOPT solves it: slower, the reference of tests and benchmarks, and a cold start."""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from hybrid_sysid_ros.control.controller import MpcSolution, Status, held
from hybrid_sysid_ros.control.mpc.horizon import new_horizon, new_instance
from hybrid_sysid_ros.control.mpc.shooting import bound_inputs
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.symbolic import symbolic_output, symbolic_step
from hybrid_sysid_ros.support.arrays import Array


class InteriorPointMpc:
    """Multiple shooting on the CasADi form, from the last solution moved on by one interval.

    Waechter & Biegler (2006), Mathematical Programming 106(1).
    """

    def __init__(self, system: System, problem: ControlProblem, *, tolerance: float = 1e-6) -> None:
        """tolerance: IPOPT's own. Raises UserError for a problem that is not the system's."""
        self.system = system
        self.problem = problem = problem.sized(system)
        self.horizon = problem.horizon
        self.period = problem.period
        self._limits = new_horizon(system, problem)
        self._flat, self._instance = new_instance(system, problem)
        self._solver, self._bounds = _statement(system, problem, tolerance)
        self._excesses = problem.horizon * (
            len(system.states) + (problem.weights.outputs.shape[1] if problem.terms else 0)
        )
        self.stage = problem.stage_values
        """Parameters (N, q) of the stages."""
        self.reset()

    def __repr__(self) -> str:
        return f"InteriorPointMpc({type(self.system).__name__}: {self.horizon} intervals of {self.period:g} s)"

    def reset(self) -> None:
        """Forget the last solution."""
        self._inputs = np.zeros((self.horizon, len(self.system.inputs)))
        self._states = np.zeros((self.horizon + 1, len(self.system.states)))
        self._cold = True

    def assign(self, **values: Any) -> None:
        """Give parameters of the stages, see :meth:`~hybrid_sysid_ros.control.mpc.mpc.ExactMpc.assign`."""
        self.problem.assign(self.stage, values)

    def prepare(self, elapsed: float) -> None:
        """Move the plan on by one interval."""
        self._inputs = np.concatenate([self._inputs[1:], self._inputs[-1:]])
        self._states = np.concatenate([self._states[1:], self._states[-1:]])

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`."""
        instance = self._instance
        previous = np.clip(previous_input, self.problem.input_low, self.problem.input_high)
        instance.assign(state, disturbance, previous, preview)
        if not np.isfinite(self._flat).all():
            return self._planned(Status.FAILED)
        if self._cold:
            self._inputs[:], self._states[:] = instance.previous, instance.state
        guess = np.concatenate([self._inputs.ravel(), self._states.ravel(), np.zeros(self._excesses)])
        found = np.array(
            self._solver(x0=guess, p=np.concatenate([self._flat, self.stage.ravel()]), **self._bounds)["x"]
        ).ravel()
        if not np.isfinite(found).all():
            return self._planned(Status.FAILED)
        self._cold = False
        self._inputs[:] = found[: self._inputs.size].reshape(self._inputs.shape)
        self._states[:] = found[self._inputs.size :][: self._states.size].reshape(self._states.shape)
        return self._planned(Status.SOLVED if self._solver.stats()["success"] else Status.NOT_CONVERGED)

    def _planned(self, status: Status) -> MpcSolution:
        """The last solution, or where there is none the input before, within the bounds."""
        if self._cold:
            return held(self._instance.previous, self.problem, status)
        inputs = self._inputs.copy()
        bound_inputs(self._limits, self._instance.previous, inputs)
        return MpcSolution(input=inputs[0].copy(), inputs=inputs, states=self._states[1:].copy(), status=status)


def _statement(system: System, problem: ControlProblem, tolerance: float) -> tuple[Any, dict[str, Array]]:
    """IPOPT for [inputs, states, excesses] of a sized problem, given [x, d, u_previous, q_1, ..., parameters of the
    stages], and its bounds.
    """
    n, m, p, count = len(system.states), len(system.inputs), len(system.outputs), problem.horizon
    weights = problem.weights
    x, u = casadi.SX.sym("x", n, count + 1), casadi.SX.sym("u", m, count)
    outside, preview = casadi.SX.sym("s", n, count), casadi.SX.sym("q", p, count)
    initial, disturbance, previous = (casadi.SX.sym(*item) for item in (("x_0", n), ("d", m), ("u_previous", m)))
    step = symbolic_step(
        system, step=problem.period / problem.substeps, substeps=problem.substeps, smoothing=problem.smoothing
    )
    output = symbolic_output(problem.outputs_of(system))
    change = u - casadi.horzcat(previous, u[:, :-1])
    drives = [u[:, i] + disturbance for i in range(count)]
    ends = casadi.horzcat(*(step(x[:, i], drives[i]) for i in range(count)))
    values, stage = weights.outputs.shape[1], casadi.SX.sym("p", len(problem.stage_parameters), count)
    if problem.terms:
        drives = [casadi.vertcat(drives[i], stage[:, i], disturbance) for i in range(count)]
    y = casadi.horzcat(*(output(x[:, i + 1], drives[i]) for i in range(count)))
    error = y - casadi.vertcat(preview, casadi.SX.zeros(values - p, count))
    cost = casadi.dot(weights.outputs.T, error**2) + casadi.dot(weights.prices.T, y)
    cost += casadi.dot(weights.rates.T, change**2) + casadi.dot(weights.inputs.T, (u - weights.rest) ** 2)
    linear, quadratic = (np.tile(price, (count, 1)).T for price in (weights.linear, weights.quadratic))
    cost += casadi.dot(linear, outside) + casadi.dot(quadratic, outside**2)
    priced = values if problem.terms else 0
    beyond = casadi.SX.sym("t", priced, count)
    for name in ("linear", "quadratic"):
        price = np.tile(getattr(weights, f"value_{name}"), (count, 1)).T[:priced]
        cost += casadi.dot(price, beyond if name == "linear" else beyond**2)
    hard = np.array([False] * p + [term.hard for term in problem.terms])
    limited = (np.isfinite(weights.value_low) | np.isfinite(weights.value_high)) & ~hard
    has_bound = np.isfinite(weights.low) | np.isfinite(weights.high)
    new = np.diff(problem.moves, prepend=-1) > 0
    rate = np.where(new[:, None], problem.rate_limits, 0.0).ravel()
    rows = [
        (x[:, 0] - initial, np.zeros(n), np.zeros(n)),
        (casadi.vec(ends - x[:, 1:]), np.zeros(n * count), np.zeros(n * count)),
        (casadi.vec(change), -rate, rate),
        (casadi.vec(x[:, 1:] + outside), weights.low.ravel(), np.full(n * count, np.inf)),
        (casadi.vec(x[:, 1:] - outside), np.full(n * count, -np.inf), weights.high.ravel()),
    ]
    if problem.terms:
        rows += [
            (casadi.vec(y + beyond), weights.value_low.ravel(), np.full(values * count, np.inf)),
            (casadi.vec(y - beyond), np.full(values * count, -np.inf), weights.value_high.ravel()),
        ]
    free = np.full(x.numel(), np.inf)
    most = np.where(has_bound, np.inf, 0.0).ravel()
    bounds = {
        "lbx": np.concatenate([np.tile(problem.input_low, count), -free, np.zeros((n + priced) * count)]),
        "ubx": np.concatenate(
            [np.tile(problem.input_high, count), free, most, np.where(limited, np.inf, 0.0)[:, :priced].ravel()]
        ),
        "lbg": np.concatenate([row[1] for row in rows]),
        "ubg": np.concatenate([row[2] for row in rows]),
    }
    statement = {
        "x": casadi.vertcat(casadi.vec(u), casadi.vec(x), casadi.vec(outside), casadi.vec(beyond)),
        "f": cost,
        "g": casadi.vertcat(*(row[0] for row in rows)),
        "p": casadi.vertcat(initial, disturbance, previous, casadi.vec(preview), casadi.vec(stage)),
    }
    options = {"print_level": 0, "sb": "yes", "max_iter": problem.max_iterations, "tol": tolerance, "mu_init": 1e-3}
    settings = {"expand": True, "print_time": False, "error_on_fail": False, "ipopt": options}
    return casadi.nlpsol("mpc", "ipopt", statement, settings), bounds
