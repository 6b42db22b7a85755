"""Steady motion: where a system settles for given outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.core import System, step_with_jacobian
from hybrid_sysid_ros.support.arrays import Array

NEWTON_STEPS = 30
STEADY = 1e-9
"""Largest relative change of an iterate at which it is called steady."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SteadyMotion:
    """States x = state + slope (q - q_0) in which the tracked outputs stay at q, near q_0.

    Steady means rest, or a drift at a constant rate that no tracked output shows: a shaft that is to turn at a speed
    turns on.
    """

    state: Array
    """(n,)."""
    slope: Array
    """(n, tracked), derivative by what the tracked outputs are to be."""
    output_map: Array
    """C (tracked, n), derivative of the tracked outputs by the states."""

    def begun(self, state: Array, outputs: Array) -> Array:
        """A state (n,) moved along steady motions to where the tracked outputs are ``outputs``, both as deviations."""
        moved: Array = state + self.slope @ (outputs - self.output_map @ state)
        return moved


def steady_motion(system: System, problem: Problem, outputs: Array) -> SteadyMotion:
    """The steady motion of a system at outputs (p,), by Newton's method from rest; a problem that is sized.

    The equations x + d = step(x, u), d = step(x + d, u) - step(x, u) linearised, y_t = output(x, u) and C d = 0 of
    the tracked outputs are solved for states x, inputs u and drift d in the sense of least squares, so that a system
    that has no steady motion there gives the nearest. What nothing moves, as an offset, stays at 0.
    """
    tracked = [k for k, weight in enumerate(problem.output_weights) if weight > 0]
    states, inputs = len(system.states), len(system.inputs)
    unknown, wanted = np.zeros(2 * states + inputs), np.asarray(outputs, dtype=float)[tracked]
    for _ in range(NEWTON_STEPS):
        following, a, b = jacobian_at(
            system, problem, unknown[:states], unknown[states : states + inputs], output=False
        )
        y, c, by_u = jacobian_at(system, problem, unknown[:states], unknown[states : states + inputs], output=True)
        c, by_u = c[tracked], by_u[tracked]
        matrix = _equations(a, b, c, by_u)
        matrix[:, :states][:, _unmoved(a, b)] = 0.0
        drift = unknown[states + inputs :]
        residual = np.concatenate(
            [following - unknown[:states] - drift, (a - np.eye(states)) @ drift, y[tracked] - wanted, c @ drift]
        )
        change = np.linalg.lstsq(matrix, -residual, rcond=None)[0]
        if not np.all(np.isfinite(change)):
            break
        unknown = unknown + change
        if np.max(np.abs(change)) <= STEADY * (1.0 + np.max(np.abs(unknown))):
            break
    raised = np.zeros((len(matrix), len(tracked)))
    raised[2 * states : 2 * states + len(tracked)] = np.eye(len(tracked))
    slope = np.linalg.lstsq(matrix, raised, rcond=None)[0][:states]
    return SteadyMotion(state=unknown[:states], slope=slope.astype(float), output_map=c)


def _unmoved(a: Array, b: Array) -> Array:
    """Which states nothing moves, (n,)."""
    return np.all(np.hstack([a - np.eye(len(a)), b]) == 0.0, axis=1)


def _equations(a: Array, b: Array, c: Array, by_u: Array) -> Array:
    """The matrix of the four equations by [x, u, d]."""
    n, m, tracked = len(a), b.shape[1], len(c)
    moving = a - np.eye(n)
    none = np.zeros((n, m))
    return np.block(
        [
            [moving, b, -np.eye(n)],
            [np.zeros((n, n)), none, moving],
            [c, by_u, np.zeros((tracked, n))],
            [np.zeros((tracked, n)), np.zeros((tracked, m)), c],
        ]
    )


def jacobian_at(system: System, problem: Problem, x: Array, u: Array, *, output: bool) -> tuple[Array, Array, Array]:
    """A step of the prediction, or the outputs, and the derivatives by states x (n,) and by inputs u (m,), stick-slip
    rounded.
    """
    step, n = problem.period / problem.substeps, len(x)
    value, jacobian = step_with_jacobian(system, x, u, step=step, smoothing=problem.smoothing, output=output)
    return value, jacobian[:, :n], jacobian[:, n:]
