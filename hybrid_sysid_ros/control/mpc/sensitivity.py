"""How a solution of the exact MPC moves with its instance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.condensing import condense, evaluate
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, Prediction, instance_of
from hybrid_sysid_ros.control.mpc.linearisation import assign, linearise
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.control.mpc.shooting import Shooting
from hybrid_sysid_ros.core.compilation import inner, kernel

Array = NDArray[np.float64]

STEP = 1e-5
"""Of the differences: of inputs in their range, of states in how far such an input moves them."""


def sensitivity(shooting: Shooting, flat: Array) -> Array:
    """Derivatives (v, n + 2 m + N p) of all inputs by the instance [x, d, u_previous, q_1, ..., q_N] at a solution.

    By the implicit function theorem with the active constraints: H du + g_p dp + A' dl = 0 and A du + a_p dp = 0.
    H is the Hessian of the Lagrangian itself, by differences of its gradient, not that of Gauss-Newton. NaN where H is
    not positive on the directions that are left free. Source: Fiacco (1983), Introduction to sensitivity and stability
    analysis in nonlinear programming, theorem 3.2.2.
    """
    horizon, program, prediction = shooting.horizon, shooting.program, shooting.prediction
    (count, n), m, p = horizon.reached.shape, horizon.inputs.shape[1], horizon.outputs.shape[1]
    v, previous, first = count * m, n + m, n + 2 * m
    states, inputs = horizon.states.copy(), horizon.inputs.copy()
    hessian, slopes = np.empty((v, v)), np.zeros((v, len(flat)))
    _differentiate(prediction, horizon, program, flat.copy(), hessian, slopes)
    slopes[:m, previous:first] = -2.0 * np.diag(horizon.weights.rates[0])
    weighted = 2.0 * horizon.weights.outputs[:, :, None] * horizon.seen
    slopes[:, first:] = -weighted.reshape(count * p, v).T

    # Constraints that hold as equations: inputs at bounds, changes at their limit, states at a bound that has a price.
    hard = v + count * len(horizon.rated)
    active = program.multipliers != 0.0
    price = np.repeat(horizon.weights.linear[horizon.bounded], count)
    active[hard:] &= np.abs(program.multipliers[hard:]) < price
    constraints = np.vstack([np.eye(v), program.rows])[active]
    moved = np.zeros((len(active), len(flat)))
    for position, j in enumerate(horizon.rated):
        moved[v + position * count, previous + j] = -1.0
    for position, state in enumerate(horizon.bounded):
        rows = slice(hard + position * count, hard + (position + 1) * count)
        moved[rows, :n] = horizon.free[:, state]
        moved[rows, n:previous] = horizon.driven[:, state].reshape(count, count, m).sum(axis=1)
    horizon.states[:], horizon.inputs[:] = states, inputs
    return _moves(hessian, slopes, constraints, moved[active])


def _moves(hessian: Array, slopes: Array, constraints: Array, moved: Array) -> Array:
    """The solution of the equations above, in the null space of the constraints and beside it."""
    bound: Array = -np.linalg.pinv(constraints) @ moved
    rank = np.linalg.matrix_rank(constraints) if len(constraints) else 0
    free = np.linalg.svd(constraints)[2][rank:].T if rank else np.eye(len(hessian))
    if not free.shape[1]:
        return bound
    try:
        factor = np.linalg.cholesky(free.T @ hessian @ free)
    except np.linalg.LinAlgError:
        return np.full_like(slopes, np.nan)
    half = np.linalg.solve(factor, free.T @ (slopes + hessian @ bound))
    return bound - free @ np.linalg.solve(factor.T, half)


@kernel
def _differentiate(
    prediction: Prediction, horizon: Horizon, program: Program, flat: Array, hessian: Array, slopes: Array
) -> None:
    """Derivatives of the Lagrangian's gradient by the inputs (v, v), and by states and disturbances into the first
    columns of ``slopes``; the trajectory is left at the solution, shot once.
    """
    (count, n), (_, m), p = horizon.reached.shape, horizon.inputs.shape, horizon.outputs.shape[1]
    v = count * m
    instance, inputs = instance_of(flat, n, m, p), horizon.inputs.copy()
    above, below = np.empty(v), np.empty(v)
    for variable in range(v + n + m):
        scale = STEP * (horizon.high[variable % m] - horizon.low[variable % m]) / 2.0
        if v <= variable < v + n:
            reach, scale = 0.0, STEP * np.max(horizon.high - horizon.low) / 2.0
            for i in range(count):
                reach = max(reach, np.max(np.abs(horizon.driven[i, variable - v, : (i + 1) * m])))
            scale = scale * reach if reach > 0.0 else scale
        elif variable >= v + n:
            j = variable - v - n
            scale = STEP * (horizon.high[j] - horizon.low[j]) / 2.0
        kept = flat[variable - v] if variable >= v else 0.0
        for side in (1.0, -1.0):
            if variable < v:
                horizon.inputs[variable // m, variable % m] = inputs[variable // m, variable % m] + side * scale
            else:
                flat[variable - v] = kept + side * scale
            _gradient(prediction, horizon, program, instance, above if side > 0.0 else below)
            if variable < v:
                horizon.inputs[variable // m, variable % m] = inputs[variable // m, variable % m]
            else:
                flat[variable - v] = kept
        for c in range(v):
            slope = (above[c] - below[c]) / (2.0 * scale)
            if variable < v:
                hessian[c, variable] = slope
            else:
                slopes[c, variable - v] = slope
    for c in range(v):
        for d in range(c):
            hessian[c, d] = hessian[d, c] = 0.5 * (hessian[c, d] + hessian[d, c])
    _gradient(prediction, horizon, program, instance, above)


@inner
def _gradient(prediction: Prediction, horizon: Horizon, program: Program, instance: Instance, out: Array) -> None:
    """Gradient (v,) of the Lagrangian by the inputs, shot once, but for what is constant in it."""
    count, v = horizon.inputs.shape[0], out.shape[0]
    weights = horizon.weights
    assign(horizon.states[0], instance.state)
    assign(horizon.disturbance, instance.disturbance)
    linearise(prediction, horizon, prediction.smoothing, True)
    condense(horizon, program)
    evaluate(horizon, program, instance, False)
    assign(out, program.gradient)
    first = horizon.rated.shape[0] * count
    for position in range(horizon.bounded.shape[0]):
        a = horizon.bounded[position]
        for i in range(count):
            row = first + position * count + i
            multiplier = program.multipliers[v + row]
            if abs(multiplier) >= weights.linear[a]:  # outside: the price of it, which grows
                above = max(horizon.states[i + 1, a] - weights.high[a], 0.0)
                below = max(weights.low[a] - horizon.states[i + 1, a], 0.0)
                multiplier = 2.0 * weights.quadratic[a] * (above - below) + np.sign(multiplier) * weights.linear[a]
            for c in range(v):
                out[c] += program.rows[row, c] * multiplier
