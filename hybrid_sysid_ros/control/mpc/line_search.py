"""The search along a step: its length, a correction for bounds that bend, and a rounder second try."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.condensing import condense, correct_bounds, cost_of, evaluate_program
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.linearisation import assign, assign_rows, keep_hard, linearise, simulate
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, Program
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.support.arrays import Array

RISE = 1e-8
"""Share of the cost by which a step may raise it: rounding, and along bounds that bend what is left of their violation
after a correction, which in flat directions exceeds all that a step gains.
"""

SMALL = 0.2
"""Largest correction of a step for bounds that bend, in steps: where it is larger, the iterate is far from a solution.
"""

HALVINGS = 8
"""Most halvings of a step in search of a cost that is not higher."""

COARSE = 30.0
"""Factor of the smoothing for a second attempt at a first step that increased the cost: where everything sticks, the
derivatives by the inputs are nearly zero.
"""


@inner
def look_along(prediction: PredictionModel, horizon: Horizon, instance: Instance, derivatives: bool) -> None:
    """Find states and outputs for the inputs, with their derivatives or, at a third of the effort, without."""
    if horizon.limits.hard.any():
        keep_hard(prediction, horizon, instance.previous, horizon.inputs)
    if derivatives:
        linearise(prediction, horizon, prediction.smoothing, True)
    else:
        simulate(prediction, horizon)


@inner
def search_along(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, cost: float, first: bool,
    derivatives: bool,
) -> float:  # fmt: skip
    """Make the step of a solution, halved until the cost is not higher; return the new cost. derivatives: linearise
    there. Most steps end where they first lead, so only there derivatives are found before the cost is known.
    """
    length, halved, hard = 1.0, False, horizon.limits.hard.any()
    if hard:
        assign_rows(horizon.inputs, horizon.step.inputs)
    _step(horizon, program, 1.0)
    for halving in range(HALVINGS + 1):
        look_along(prediction, horizon, instance, derivatives and not halved)
        found = cost_of(horizon, instance)
        if found <= cost + RISE * abs(cost):
            break
        if (
            halving == 0
            and correct_bounds(horizon, program)
            and _corrected(prediction, horizon, program, instance, cost, derivatives)
        ):
            found = cost_of(horizon, instance)
            break
        halved = True
        if halving < HALVINGS:
            length *= 0.5
            if hard:
                assign_rows(horizon.step.inputs, horizon.inputs)
            _step(horizon, program, length if hard else -length)
        if first and halving == 1 and prediction.smoothing > 0.0:
            _step(horizon, program, -length)
            length = _coarse_step(prediction, horizon, program, instance)
    if halved and derivatives:
        linearise(prediction, horizon, prediction.smoothing, True)
    return found


@inner
def _corrected(
    prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance, cost: float,
    derivatives: bool,
) -> bool:  # fmt: skip
    """Replace the step by one for the bounds that were found at its end; False where that costs more, too, or leads
    elsewhere: then the step is as before. Nocedal & Wright (2006), section 15.6: without this correction the price of
    bounds that bend shortens all steps along them (Maratos).
    """
    v = program.solution.shape[0]
    step, multipliers = np.empty(v), np.empty(program.multipliers.shape[0])
    assign(step, program.solution)
    assign(multipliers, program.multipliers)
    sound = quadratic.solve(program, GRADIENT | BOUNDS | STATES)
    size = change = 0.0
    for c in range(v):
        size += step[c] * step[c]
        change += (program.solution[c] - step[c]) * (program.solution[c] - step[c])
    if sound and change <= SMALL * SMALL * size:
        _step(horizon, program, 1.0)
        _move(horizon, step, -1.0)
        look_along(prediction, horizon, instance, derivatives)
        if cost_of(horizon, instance) <= cost + RISE * abs(cost):
            quadratic.keep_working_set(program)
            return True
        _step(horizon, program, -1.0)
        _move(horizon, step, 1.0)
    assign(program.solution, step)
    assign(program.multipliers, multipliers)
    return False


@inner
def _coarse_step(prediction: PredictionModel, horizon: Horizon, program: Program, instance: Instance) -> float:
    """Make the step that results from a larger smoothing; return its length, 0 where there is none."""
    linearise(prediction, horizon, COARSE * prediction.smoothing, True)
    condense(horizon, program)
    evaluate_program(horizon, program, instance, False)
    if not quadratic.solve(program, MATRICES | GRADIENT | BOUNDS | STATES):
        return 0.0
    quadratic.keep_working_set(program)
    _step(horizon, program, 1.0)
    return 1.0


@inner
def _step(horizon: Horizon, program: Program, length: float) -> None:
    """Move the inputs along the solution."""
    _move(horizon, program.solution, length)


@inner
def _move(horizon: Horizon, step: Array, length: float) -> None:
    """Move the inputs along a step (v,)."""
    count, m = horizon.inputs.shape
    for i in range(count):
        for j in range(m):
            horizon.inputs[i, j] += length * step[horizon.limits.moves[i] * m + j]
