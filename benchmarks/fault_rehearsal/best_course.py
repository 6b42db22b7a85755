"""Best course: what nobody can do better who knows an actuator's fault, its end, and every state, before it begins."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np

from benchmarks.fault_rehearsal.signal_faults import LASTING, Fault, Moment
from hybrid_sysid_ros.core.symbolic import symbolic_output, symbolic_step
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

GRID = 33
"""Commands of each input, from its lowest to its highest, by which it is found what can act."""
LEAVES = 1e3
"""Price of a state outside of its range, as a share of that, beside SMALL of the squared error in tolerances."""
SMALL, MIDDLE = 1e-4, 1e-5
"""Weights of squared errors, and of inputs away from the middle of their range, which makes the optimum one."""
ROUNDING = 0.05
"""Of the corners of dry friction [unit of the velocity]."""


def acting_range(fault: Fault, since: float, period: float, limits: tuple[Array, Array]) -> tuple[Array, Array]:
    """Lowest and highest inputs (m,) that can act at a time since the fault began [s]."""
    if fault.acts is None or not 0.0 <= since < LASTING:
        return limits
    low, high = limits
    random, number = np.random.default_rng(0), round(since / period)
    tried: Array = np.linspace(low, high, GRID, dtype=np.float64)
    acted = np.array([fault.acts()(Moment(since, number, random), command.copy()) for command in tried])
    return np.clip(acted.min(axis=0), low, high), np.clip(acted.max(axis=0), low, high)


def best_course(
    rig: Rig, fault: Fault, state: Array, reference: Callable[[Array], Array], tolerance: Array, *, begin: float,
    window: tuple[float, float], period: float,
) -> tuple[float, bool]:  # fmt: skip
    """The smallest error of the tracked outputs in tolerances (p,), rms over a window [s since the fault began], and
    whether travel and validity are kept on that course, from a state (n,) at the beginning on [s].

    Delays of inputs are left out, which only helps. It is a local optimum of IPOPT's, by multiple shooting at intervals
    of ``period`` [s]: a small error shows that a fault can be held, a large one only that none was found. fault: what
    can act at a moment must not depend on what was sent before.
    """
    count, (low, high) = math.ceil(window[1] / period), rig.limits
    n, m, tracked = len(state), len(low), np.flatnonzero(np.isfinite(tolerance))
    substeps = max(1, round(period / (10.0 * rig.step)))
    step = symbolic_step(rig.system, step=period / substeps, substeps=substeps, smoothing=ROUNDING)
    output = symbolic_output(rig.system)
    problem = casadi.Opti()
    x, share = problem.variable(n, count + 1), problem.variable(m, count)
    outside = problem.variable()
    wanted = reference(begin + period * np.arange(1.0, count + 1.0, dtype=np.float64))
    problem.subject_to(x[:, 0] == state)
    problem.subject_to(problem.bounded(0.0, casadi.vec(share), 1.0))
    problem.subject_to(outside >= 0.0)
    errors: list[Any] = []
    for i in range(count):
        least, most = acting_range(fault, i * period, period, (low, high))
        u = least + (most - least) * share[:, i]
        problem.subject_to(step(x[:, i], u) == x[:, i + 1])
        errors.append((output(x[:, i + 1], u) - wanted[i]) / tolerance)
    for ends in (rig.travel, *([] if rig.validity is None else [rig.validity])):
        for a in range(n):
            width = ends[1][a] - ends[0][a]
            if np.isfinite(width):
                problem.subject_to(x[a, 1:] / width <= ends[1][a] / width + outside)
                problem.subject_to(x[a, 1:] / width >= ends[0][a] / width - outside)
    judged = [errors[i] for i in range(count) if window[0] <= (i + 1) * period < window[1]]
    squares = [sum(error[k] ** 2 for error in judged) / len(judged) for k in tracked.tolist()]
    problem.minimize(SMALL * sum(squares) + LEAVES * outside + MIDDLE * casadi.sumsqr(share - 0.5))
    problem.set_initial(x, np.tile(state[:, None], count + 1))
    problem.set_initial(share, 0.5)
    problem.solver("ipopt", {"print_time": False, "expand": True}, {"print_level": 0, "sb": "yes", "max_iter": 300})
    try:
        found = problem.solve()
    except RuntimeError:
        return math.inf, False
    return math.sqrt(max(found.value(square) for square in squares)), bool(found.value(outside) < 1e-3)
