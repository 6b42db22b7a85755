"""How a solution of the exact MPC moves with its question."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc import horizon as hz
from hybrid_sysid_ros.control.mpc.horizon import Question
from hybrid_sysid_ros.control.mpc.shooting import Shooting

Array = NDArray[np.float64]

STEP = 1e-5
"""Of the differences: of inputs in their limit, of states in how far such an input moves them."""


def sensitivity(shooting: Shooting, question: Question) -> Array:
    """Derivatives (horizon, states + 2 + horizon) of the inputs by [x, d, u_previous, q_1..q_N] at a solution.

    By the implicit function theorem with the active constraints: H du + g_p dp + A' dl = 0 and A du + a_p dp = 0.
    H is the Hessian of the Lagrangian itself, by differences of its gradient, not that of Gauss-Newton. NaN where H is
    not positive on the directions that are left free. Source: Fiacco (1983), Introduction to sensitivity and stability
    analysis in nonlinear programming, theorem 3.2.2.
    """
    horizon, program, model = shooting.horizon, shooting.program, shooting.model._replace(single=True)
    count, states = horizon.reached.shape
    kept = horizon.inputs.copy(), horizon.states.copy()
    hessian, slopes = np.empty((count, count)), np.zeros((count, states + 2 + count))
    _differentiate(shooting.prepare, model, horizon, program, question, hessian, slopes)
    horizon.inputs[:] = kept[0]
    shooting.prepare(model, horizon, program)
    slopes[0, states + 1] = -2.0 * horizon.weights[1, 0]
    slopes[:, states + 2 :] = -2.0 * (horizon.weights[0, :, None] * horizon.driven[:, horizon.output]).T

    # Constraints that hold as equations: inputs at bounds, changes at their limit, states at a bound that has a price.
    changes = program.rows.shape[0] - count * len(horizon.bounded)
    active = program.multipliers != 0.0
    active[count + changes :] &= np.abs(program.multipliers[count + changes :]) < horizon.price[0]
    constraints = np.vstack([np.eye(count), program.rows])[active]
    moved = np.zeros((len(active), slopes.shape[1]))
    if changes:
        moved[count, states + 1] = -1.0
    for position, state in enumerate(horizon.bounded):
        rows = slice(count + changes + position * count, count + changes + (position + 1) * count)
        moved[rows, :states] = horizon.free[:, state]
        moved[rows, states] = horizon.driven[:, state].sum(axis=1)
    horizon.states[:] = kept[1]

    bound = -np.linalg.pinv(constraints) @ moved[active]
    free = np.linalg.svd(constraints)[2][np.linalg.matrix_rank(constraints) :].T if len(constraints) else np.eye(count)
    if not free.shape[1]:
        return bound
    try:
        factor = np.linalg.cholesky(free.T @ hessian @ free)
    except np.linalg.LinAlgError:
        return np.full_like(slopes, np.nan)
    half = np.linalg.solve(factor, free.T @ (slopes + hessian @ bound))
    moves: Array = bound - free @ np.linalg.solve(factor.T, half)
    return moves


@numba.njit(**hz.OPTIONS)
def _differentiate(
    prepare: Any, model: Any, horizon: Any, program: Any, question: Any, hessian: Array, slopes: Array
) -> None:
    """Derivatives of the Lagrangian's gradient by the inputs, the state and the disturbance."""
    count, states = horizon.reached.shape
    inputs, begun, offset = horizon.inputs.copy(), question.state.copy(), question.disturbance[0]
    above, below = np.empty(count), np.empty(count)
    step = STEP * horizon.input_limit
    for variable in range(count + states + 1):
        h = step
        if count <= variable < count + states:
            reach = 0.0
            for i in range(count):
                reach = max(reach, np.max(np.abs(horizon.driven[i, variable - count, : i + 1])))
            h = step * reach if reach > 0.0 else step
        for side in (1.0, -1.0):
            if variable < count:
                horizon.inputs[variable] = inputs[variable] + side * h
            elif variable < count + states:
                question.state[variable - count] = begun[variable - count] + side * h
            else:
                question.disturbance[0] = offset + side * h
            hz.assign(horizon.states[0], question.state)
            horizon.disturbance[0] = question.disturbance[0]
            prepare(model, horizon, program)
            _gradient(horizon, program, question, above if side > 0.0 else below)
            hz.assign(horizon.inputs, inputs)
            hz.assign(question.state, begun)
            question.disturbance[0] = offset
        for j in range(count):
            slope = (above[j] - below[j]) / (2.0 * h)
            if variable < count:
                hessian[j, variable] = slope
            else:
                slopes[j, variable - count] = slope
    for j in range(count):
        for k in range(j):
            hessian[j, k] = hessian[k, j] = 0.5 * (hessian[j, k] + hessian[k, j])
    hz.assign(horizon.states[0], begun)
    horizon.disturbance[0] = offset


@hz.inner
def _gradient(horizon: Any, program: Any, question: Any, out: Array) -> None:
    """Gradient (horizon,) of the Lagrangian by the inputs, but for what is constant in it."""
    count = horizon.inputs.shape[0]
    hz.evaluate(horizon, program, question)
    hz.assign(out, program.gradient)
    first = program.rows.shape[0] - count * horizon.bounded.shape[0]
    for position in range(horizon.bounded.shape[0]):
        a = horizon.bounded[position]
        for i in range(count):
            row = first + position * count + i
            multiplier = program.multipliers[count + row]
            if abs(multiplier) >= horizon.price[0]:  # outside: the price of it, which grows
                above = max(horizon.states[i + 1, a] - horizon.upper[a], 0.0)
                below = max(horizon.lower[a] - horizon.states[i + 1, a], 0.0)
                multiplier = 2.0 * horizon.price[1] * (above - below) + np.sign(multiplier) * horizon.price[0]
            for j in range(i + 1):
                out[j] += program.rows[row, j] * multiplier
