"""Steady motions: where tracked outputs stay at given values."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System, step_with_jacobian
from hybrid_sysid_ros.support.arrays import Array

NEWTON_STEPS = 30
STEADY = 1e-9
"""Largest relative change of an iterate that counts as steady."""
SHARP = 0.03
"""Rounding of stick-slip, in the speed of a motion, at which bristles deflect as without."""


class SteadyMotion(NamedTuple):
    """A motion in which the tracked outputs stay at given values.

    Steady means rest, or a drift at a constant rate that no tracked output shows, such as the angle of a shaft with a
    tracked speed.
    """

    state: Array
    """(n,)."""
    inputs: Array
    """(m,)."""
    output_map: Array
    """C (tracked, n), derivative of the tracked outputs by the states there."""


def steady_motion(system: System, problem: ControlProblem, outputs: Array) -> SteadyMotion:
    """The steady motion of a system at outputs (p,), by Newton's method from rest; the problem is sized.

    The equations x + d = step(x, u), d = step(x + d, u) - step(x, u) linearised, y_t = output(x, u) and C d = 0 of
    the tracked outputs are solved for states x, inputs u and drift d in the sense of least squares, so that a system
    without a steady motion there gives the nearest. States that nothing moves, such as offsets, stay at 0.
    Bristles on a slow motion deflect as in the exact form: where it is rounded, the more the slower they slide.
    """
    wanted = np.asarray(outputs, dtype=float)
    unknown, found = _steady(system, problem, wanted, np.zeros(2 * len(system.states) + len(system.inputs)))
    names, declared = [item.name for item in system.states], len(system.declared_states)
    speeds = [abs(unknown[names.index(item.on)]) for item in system.contacts if item.hidden]
    rounding = SHARP * min(speeds, default=math.inf)
    if 0.0 < rounding < problem.smoothing:
        unknown[declared : len(names)] = 0.0
        sharp, _ = _steady(system, replace(problem, smoothing=rounding), wanted, unknown)
        unknown = sharp if np.isfinite(sharp).all() else unknown
    return SteadyMotion(unknown[: len(names)], unknown[len(names) : len(names) + len(system.inputs)], found)


_KNOWN: dict[Any, Array] = {}


def output_map_at(system: System, problem: ControlProblem, outputs: Array) -> Array:
    """C (tracked, n) of the steady motion at outputs (p,). The last one is kept: scenarios ask for it over and over."""
    key = system.form, system.values.tobytes(), system.weights.tobytes(), problem, outputs.tobytes()
    found = _KNOWN.get(key)
    if found is None:
        _KNOWN.clear()
        found = _KNOWN[key] = steady_motion(system, problem, outputs).output_map
    return found


def _steady(system: System, problem: ControlProblem, outputs: Array, unknown: Array) -> tuple[Array, Array]:
    """[x, u, d] of the four equations, from a first iterate, and C there."""
    tracked = [k for k, weight in enumerate(problem.output_weights) if weight > 0]
    states, inputs, wanted = len(system.states), len(system.inputs), outputs[tracked]
    rest = np.eye(states)
    for _ in range(NEWTON_STEPS):
        following, a, b = jacobian_at(
            system, problem, unknown[:states], unknown[states : states + inputs], output=False
        )
        y, c, by_u = jacobian_at(system, problem, unknown[:states], unknown[states : states + inputs], output=True)
        c, by_u, moving = c[tracked], by_u[tracked], a - rest
        matrix = _equations(moving, b, c, by_u)
        unmoved = ~(moving.any(axis=1) | b.any(axis=1))
        matrix[:, :states][:, unmoved] = 0.0
        drift = unknown[states + inputs :]
        residual = np.concatenate(
            [following - unknown[:states] - drift, moving @ drift, y[tracked] - wanted, c @ drift]
        )
        change = np.linalg.lstsq(matrix, -residual, rcond=None)[0]
        if not np.all(np.isfinite(change)):
            break
        unknown = unknown + change
        if np.max(np.abs(change)) <= STEADY * (1.0 + np.max(np.abs(unknown))):
            break
    return unknown, c


def _equations(moving: Array, b: Array, c: Array, by_u: Array) -> Array:
    """The matrix of the four equations by [x, u, d]; moving: a - 1."""
    n, m, tracked = len(moving), b.shape[1], len(c)
    drift, seen = n + m, 2 * n + tracked
    matrix = np.zeros((seen + tracked, drift + n))
    matrix[:n, :n], matrix[:n, n:drift], matrix[:n, drift:] = moving, b, -np.eye(n)
    matrix[n : 2 * n, drift:] = moving
    matrix[2 * n : seen, :n], matrix[2 * n : seen, n:drift] = c, by_u
    matrix[seen:, drift:] = c
    return matrix


def jacobian_at(
    system: System, problem: ControlProblem, x: Array, u: Array, *, output: bool
) -> tuple[Array, Array, Array]:
    """A step of the prediction, or the outputs, and the derivatives by states x (n,) and by inputs u (m,), with rounded
    stick-slip.
    """
    step, n = problem.period / problem.substeps, len(x)
    value, jacobian = step_with_jacobian(system, x, u, step=step, smoothing=problem.smoothing, output=output)
    return value, jacobian[:, :n], jacobian[:, n:]
