"""Closed loops of one exact MPC in compiled code."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.batch import Effort, MpcAnswers, answer_row
from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel, instance_of
from hybrid_sysid_ros.control.mpc.linearisation import assign, follow
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.control.stage_cost import StageWeights
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.shared import Shared
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopArrays(Shared):
    """A closed loop of T periods: what disturbs it, and its course."""

    initial_states: Array
    initial_inputs: Array
    references: Array
    disturbances: Array
    pushes: Array
    state_errors: Array
    disturbance_errors: Array
    input_errors: Array
    states: Array
    """(T + 1, n), before each period's push, and at the end."""
    inputs: Array
    """(T, m)."""
    costs: Array
    """(T,)."""
    excess: Array
    """(1,), largest distance of a state from its bounds."""

    @classmethod
    def empty(cls, periods: int, horizon: int, states: int, inputs: int, outputs: int) -> LoopArrays:
        """Room for a loop."""
        T, n, m = periods, states, inputs
        shapes = {
            "initial_states": (T, n),
            "initial_inputs": (T, m),
            "references": (T + horizon - 1, outputs),
            "disturbances": (T, m),
            "pushes": (T, n),
            "state_errors": (T, n),
            "disturbance_errors": (T, m),
            "input_errors": (T, m),
            "states": (T + 1, n),
            "inputs": (T, m),
            "costs": (T,),
            "excess": (1,),
        }
        return cls(**{name: np.zeros(shape) for name, shape in shapes.items()})


@kernel
def answer_loop(
    prediction: PredictionModel,
    horizon: Horizon,
    program: Program,
    effort: Effort,
    asked: Array,
    begins: NDArray[np.bool_],
    answers: MpcAnswers,
    plant: PredictionModel,
    weights: StageWeights,
    loop: LoopArrays,
) -> None:
    """Answer what the plant leads to, in the exact form; it is written into ``asked`` (T, n + 2 m + N p). weights:
    those of one stage.
    """
    (n, m), p, none = horizon.linear.B.shape[1:], loop.references.shape[1], np.empty((0, 0, 0))
    flat, one = np.empty(asked.shape[1]), np.empty(n + 2 * m + p)
    instance, stage = instance_of(flat, n, m, p), instance_of(one, n, m, p)
    cold = True
    for k in range(asked.shape[0]):
        anew = begins[k] or k == 0
        ask_controller(horizon, stage, loop, anew, k, asked[k])
        assign(flat, asked[k])
        cold = answer_row(prediction, horizon, program, effort, instance, anew, cold, none, answers, k)
        advance_plant(plant, weights, stage, answers.inputs[k], loop, k)


@inner
def ask_controller(horizon: Horizon, stage: Instance, loop: LoopArrays, begins: bool, k: int, asked: Array) -> None:
    """Write the instance of period k for the controller, and that of the plant's ``stage`` without errors."""
    n, m, p = stage.state.shape[0], stage.previous.shape[0], stage.preview.shape[1]
    if begins:
        assign(stage.state, loop.initial_states[k])
        assign(stage.previous, loop.initial_inputs[k])
    assign(loop.states[k], stage.state)
    assign(stage.disturbance, loop.disturbances[k])
    assign(stage.preview[0], loop.references[k])
    for a in range(n):
        stage.state[a] += loop.pushes[k, a]
        asked[a] = stage.state[a] + loop.state_errors[k, a]
    for j in range(m):
        asked[n + j] = stage.disturbance[j] + loop.disturbance_errors[k, j]
        before = stage.previous[j] + loop.input_errors[k, j]
        asked[n + m + j] = min(max(before, horizon.limits.low[j]), horizon.limits.high[j])
    for i in range(horizon.inputs.shape[0]):
        for c in range(p):
            asked[n + 2 * m + i * p + c] = loop.references[k + i, c]


@inner
def advance_plant(
    plant: PredictionModel, weights: StageWeights, stage: Instance, inputs: Array, loop: LoopArrays, k: int
) -> None:
    """Advance the plant by period k under the first inputs of a plan."""
    n = stage.state.shape[0]
    path, applied = np.empty((2, n)), np.empty((1, inputs.shape[1]))
    assign(applied[0], inputs[0])
    loop.costs[k], excess = follow(plant, weights, stage, applied, path)
    assign(stage.state, path[1])
    assign(stage.previous, applied[0])
    assign(loop.inputs[k], applied[0])
    assign(loop.states[k + 1], path[1])
    for a in range(n):
        excess = excess if math.isfinite(path[1, a]) else np.inf
    loop.excess[0] = max(loop.excess[0], excess)
