"""A peer of the MPC, the linear quadratic regulator: its cost without bounds on a linear model, solved once for all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, null_space, solve_discrete_are

from hybrid_sysid_ros.control.controller import MpcSolution, Status
from hybrid_sysid_ros.control.mpc.horizon import Horizon, PredictionModel, new_horizon, prediction
from hybrid_sysid_ros.control.mpc.linearisation import linearise
from hybrid_sysid_ros.control.mpc.shooting import bound_inputs
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NEWTON_STEPS = 50
ROUNDING_ERROR = 1e-9
"""Largest difference of a state from itself an interval later that is called rest, relative."""
MARGIN = 1e-6
"""Least distance of a closed loop's eigenvalues from the circle of 1: by rounding, a solver of Riccati's equation may
call a motion damped that nothing damps.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """A point of rest and the linear model about it, of one interval: n states, m inputs, p outputs."""

    point: Array
    """[x, u] (n + m,)."""
    outputs: Array
    """(p,)."""
    transition: Array
    """A (n, n)."""
    gain: Array
    """B (n, m)."""
    reading: Array
    """[C, D] (p, n + m), of the outputs at the end of an interval by the states there and the inputs of it."""


class LinearQuadraticRegulator:
    """u = u_- + K (z_s - z) + sum_i g_i (q_i - q_N), within the bounds; z = [x, u_-].

    It minimises sum_{i>=1} (y_i - q_i)' W (y_i - q_i) + sum_{i>=0} of the weights of changes and of (u_i - u_s)
    over the linear model x+ = A x + B (u + d) about a rest, where the reference stays at q_N and the disturbance at d
    for ever: the MPC's own weights, without end and without bounds.

    z_s is the state of rest at q_N with the inputs that compensate d, so that tracking is offset-free without an
    integral (Pannocchia & Rawlings 2003, AIChE J. 49(2)); where there are fewer inputs than tracked outputs it is the
    rest nearest to q_N by their weights. K is the gain of the discrete algebraic Riccati equation, g
    that of the previewed reference (Tomizuka 1975, J. Dyn. Sys. Meas. Control 97(2)); a bounded input does not wind
    anything up, for u_- is the input that was applied.
    """

    def __init__(
        self,
        system: System,
        problem: ControlProblem,
        *,
        smoothing: float | None = None,
        preview: bool = True,
        about: Array | None = None,
    ) -> None:
        """smoothing: of stick-slip where the model is linearised, the problem's by default: what rests
        sticks, and what a linear law takes dry friction for is a choice. preview: without it the reference is taken to
        stay where it will be in a period. about (p,): tracked outputs at rest, zeros by default.

        Raises UserError for a model that doesn't rest there, or that the weights don't stabilise.
        """
        problem = problem.sized(system)
        self.problem = problem if smoothing is None else replace(problem, smoothing=smoothing)
        self.horizon = problem.horizon
        self.period = problem.period
        self._previewing = preview
        self._limits = new_horizon(system, problem)
        wanted = np.zeros(len(system.outputs)) if about is None else np.asarray(about, dtype=float)
        self.rest = _rest(system, self.problem, wanted)
        self.feedback, self.feedforward, self.target = _gains(self.rest, self.problem)

    def reset(self) -> None:
        """It remembers nothing."""

    def prepare(self, elapsed: float) -> None:
        """It has nothing to prepare."""

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`. What is not a number gives HELD."""
        previous = np.asarray(previous_input, dtype=float)
        last = np.clip(
            np.where(np.isfinite(previous), previous, 0.0), self._limits.limits.low, self._limits.limits.high
        )
        preview = np.asarray(preview, dtype=float)
        final = preview[-1] if self._previewing else preview[0]
        target = self.rest.point + self.target @ (final - self.rest.outputs)
        target[len(state) :] -= disturbance
        change = self.feedback @ (target - np.concatenate([state, last]))
        if self._previewing:
            change = change + np.einsum("ijk,ik->j", self.feedforward, preview - final)
        sound = bool(np.isfinite(change).all() and np.isfinite(previous).all())
        inputs = (last + change if sound else last)[None].copy()
        bound_inputs(self._limits, last, inputs)
        states = np.zeros((0, len(self.rest.transition)))
        return MpcSolution(
            input=inputs[0].copy(), inputs=inputs, states=states, status=Status.FEEDBACK if sound else Status.HELD
        )


@kernel
def _linearised(prediction: PredictionModel, horizon: Horizon) -> None:
    linearise(prediction, horizon, prediction.smoothing, False)


def _rest(system: System, problem: ControlProblem, wanted: Array) -> Rest:
    """Newton's method for a point of rest with the tracked outputs at ``wanted`` (p,), as near as they get."""
    n, m = len(system.states), len(system.inputs)
    horizon, model = new_horizon(system, replace(problem, horizon=1)), prediction(system, problem)
    point = np.zeros(n + m)
    for _ in range(NEWTON_STEPS):
        horizon.states[:], horizon.inputs[:] = point[:n], point[n:]
        _linearised(model, horizon)
        found = Rest(
            point=point,
            outputs=horizon.linear.outputs[0].copy(),
            transition=horizon.linear.A[0].copy(),
            gain=horizon.linear.B[0].copy(),
            reading=np.hstack([horizon.linear.C[0], horizon.linear.D[0]]),
        )
        moved = horizon.linear.reached[0] - point[:n]
        if not (np.isfinite(moved).all() and np.isfinite(found.outputs).all()):
            break
        back = -np.linalg.lstsq(_balance(found), moved, rcond=None)[0]
        step = back + _target(found, problem) @ (wanted - found.outputs - found.reading @ back)
        small = ROUNDING_ERROR * (1.0 + np.max(np.abs(point)))
        if np.max(np.abs(moved)) <= small and np.max(np.abs(found.reading @ step)) <= small:
            return found
        point = point + step
    raise UserError(
        f"{type(system).__name__}: does not rest at outputs {wanted.tolist()}, so it can't be linearised there"
    )


def _balance(rest: Rest) -> Array:
    """The matrix of A x + B u - x = 0, (n, n + m)."""
    return np.hstack([rest.transition - np.eye(len(rest.transition)), rest.gain])


def _target(rest: Rest, problem: ControlProblem) -> Array:
    """Derivative (n + m, p) of the rest by the outputs that are wanted, nearest by their weights."""
    roots = np.sqrt(problem.stage_weights.outputs[0])
    free = null_space(_balance(rest))
    found: Array = free @ np.linalg.pinv(roots[:, None] * rest.reading @ free) * roots
    return found


def _gains(rest: Rest, problem: ControlProblem) -> tuple[Array, Array, Array]:
    """K (m, n + m), g (horizon, m, p) and the derivative (n + m, p) of the rest [x, u] by its outputs.

    With the inputs before as states and their changes w as the inputs, z+ = F z + G w, z = [x, u_-].
    """
    n, m = rest.gain.shape
    stage, reading = problem.stage_weights, rest.reading
    through = np.block([[rest.transition, rest.gain], [np.zeros((m, n)), np.eye(m)]])
    change = np.vstack([rest.gain, np.eye(m)])
    outputs, inputs = np.diag(stage.outputs[0]), np.diag(stage.inputs[0])
    weights = reading.T @ outputs @ reading
    weights[n:, n:] += inputs
    crossed = np.vstack([np.zeros((n, m)), inputs])
    price = np.diag(stage.rates[0]) + inputs
    try:
        value = solve_discrete_are(through, change, weights, price, s=crossed)
        curvature = price + change.T @ value @ change
        feedback = np.linalg.solve(curvature, change.T @ value @ through + crossed.T)
        if np.max(np.abs(np.linalg.eigvals(through - change @ feedback))) > 1.0 - MARGIN:
            raise LinAlgError("what it leaves is not damped")
    except (LinAlgError, ValueError) as error:
        raise UserError(
            f"regulator: no linear feedback stabilises the model under these weights ({error}); where fewer outputs "
            "are tracked than there are inputs, the inputs need weights"
        ) from error
    closed, ahead = through - change @ feedback, change
    feedforward = np.zeros((problem.horizon, m, len(reading)))
    for i in range(problem.horizon):
        feedforward[i] = np.linalg.solve(curvature, (reading @ ahead).T @ outputs)
        ahead = closed @ ahead
    return feedback, feedforward, _target(rest, problem)
