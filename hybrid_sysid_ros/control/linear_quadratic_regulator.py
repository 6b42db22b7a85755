"""The linear quadratic regulator: the MPC's cost without bounds on a linear model, solved once and for all."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, solve_discrete_are

from hybrid_sysid_ros.control.controller import Plan, Status
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.adapters import linearisation, workspace
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

NEWTON_STEPS = 50
ROUNDING_ERROR = 1e-9
"""Largest difference of a state from itself an interval later that is called rest, relative."""


class LinearQuadraticRegulator:
    """u = u_- + K (z_s - z) + sum_i g_i (q_i - q_N), within the bounds; z = [x, u_-].

    It minimises sum_{i>=1} output_weight ((y_i - q_i) / output_scale)^2 + sum_{i>=0} rate_weight (u_i - u_{i-1})^2
    + input_weight (u_i - u_s)^2 over the linear model x+ = A x + B (u + d) about its rest at output 0, where the
    reference stays at q_N and the disturbance at d for ever: the MPC's own weights, without end and without bounds.

    z_s is the state of rest at q_N with the input that compensates d, so that tracking is offset-free without an
    integral (Pannocchia & Rawlings 2003, AIChE J. 49(2)). K is the gain of the discrete algebraic Riccati equation, g
    that of the previewed reference (Tomizuka 1975, J. Dyn. Sys. Meas. Control 97(2)); a bounded input does not wind
    anything up, for u_- is the input that was applied.
    """

    def __init__(
        self, system: System, problem: Problem, *, smoothing: float | None = None, preview: bool = True
    ) -> None:
        """smoothing: of stick-slip where the model is linearised [rad/s], the problem's by default: a resting beam
        sticks, and what a linear law takes dry friction for is a choice. preview: without it the reference is taken to
        stay where it will be in a period.

        Raises UserError for a model that doesn't rest at output 0, or that the weights don't stabilise.
        """
        if len(system.inputs) != 1:
            raise UserError(f"{type(system).__name__}: the regulator takes models of one input")
        self.problem = problem
        self.horizon = problem.horizon
        self.period = problem.period
        self.output = system.measured[0]
        self._previewing = preview
        smoothing = problem.smoothing if smoothing is None else smoothing
        self.rest, self.transition, self.gain = _rest(system, problem, smoothing)
        self.feedback, self.feedforward, self.target = _gains(self.transition, self.gain, self.output, problem)

    def reset(self) -> None:
        """It remembers nothing."""

    def prepare(self, elapsed: float) -> None:
        """It has nothing to prepare."""

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`. What is not a number gives HELD."""
        limit, rate = self.problem.input_limit, self.problem.rate_limit
        previous = float(previous_input[0])
        last = min(max(previous, -limit), limit) if math.isfinite(previous) else 0.0
        final = preview[-1] if self._previewing else preview[0]
        target = self.rest + self.target * (final - self.rest[self.output])
        target[-1] -= disturbance[0]
        change = float(self.feedback @ (target - np.append(state, last)))
        if self._previewing:
            change += float(self.feedforward @ (preview - final))
        if not (math.isfinite(change) and math.isfinite(previous)):
            return self._plan(last, Status.HELD)
        return self._plan(min(max(last + min(max(change, -rate), rate), -limit), limit), Status.FEEDBACK)

    def _plan(self, value: float, status: Status) -> Plan:
        inputs = np.array([[value]])
        return Plan(input=inputs[0], inputs=inputs, states=np.zeros((0, len(self.transition))), status=status)


def _rest(system: System, problem: Problem, smoothing: float) -> tuple[Array, Array, Array]:
    """[x, u] (states + 1,) at rest with output 0, and there A (states, states) and B (states, 1) of an interval."""
    states, output = len(system.states), system.measured[0]
    linearise, rows = linearisation(system, smoothing=smoothing), workspace(system)
    point, following = np.zeros(states + 1), np.zeros(states)
    transition, gain = np.zeros((states, states)), np.zeros((states, 1))
    step = problem.period / problem.substeps
    for _ in range(NEWTON_STEPS):
        given = (point[:-1], point[-1:], system.values, system.weights, step, problem.substeps)
        linearise(*given, rows, following, transition, gain)
        moved = np.append(following - point[:-1], point[output])
        if not np.all(np.isfinite(moved)):
            break
        if np.max(np.abs(moved)) <= ROUNDING_ERROR * (1.0 + np.max(np.abs(point))):
            return point, transition, gain
        point = point - np.linalg.lstsq(_resting(transition, gain, output), moved, rcond=None)[0]
    raise UserError(f"{type(system).__name__}: does not rest at output 0, so it can't be linearised there")


def _resting(transition: Array, gain: Array, output: int) -> Array:
    """The matrix of A x + B u - x = 0, y = q."""
    states = len(transition)
    reading = np.append(np.eye(states)[output], 0.0)
    return np.vstack([np.hstack([transition - np.eye(states), gain]), reading])


def _gains(transition: Array, gain: Array, output: int, problem: Problem) -> tuple[Array, Array, Array]:
    """K (states + 1,), g (horizon,) and the derivative (states + 1,) of the rest [x, u] by its output.

    With the input before as a state and its change w as the input, z+ = F z + G w, z = [x, u_-].
    """
    states = len(transition)
    through = np.block([[transition, gain], [np.zeros((1, states)), np.ones((1, 1))]])
    change = np.vstack([gain, np.ones((1, 1))])
    reading = np.append(np.eye(states)[output], 0.0)
    output_weight = problem.output_weight / problem.output_scale**2
    weights = output_weight * np.outer(reading, reading)
    weights[-1, -1] = problem.input_weight
    crossed = np.zeros((states + 1, 1))
    crossed[-1] = problem.input_weight
    price = np.array([[problem.rate_weight + problem.input_weight]])
    try:
        value = solve_discrete_are(through, change, weights, price, s=crossed)
        slope = np.linalg.solve(_resting(transition, gain, output), np.append(np.zeros(states), 1.0))
    except (LinAlgError, ValueError) as error:
        raise UserError(f"regulator: no linear feedback stabilises the model under these weights ({error})") from error
    curvature = float((price + change.T @ value @ change)[0, 0])
    feedback = ((change.T @ value @ through + crossed.T) / curvature)[0]
    closed = through - np.outer(change, feedback)
    feedforward, ahead = np.zeros(problem.horizon), change[:, 0] / curvature
    for i in range(problem.horizon):
        feedforward[i] = output_weight * (ahead @ reading)
        ahead = closed @ ahead
    return feedback, feedforward, slope
