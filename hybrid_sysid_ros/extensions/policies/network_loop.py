"""Loops that a network alone drives, in compiled code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.calls import hold
from hybrid_sysid_ros.control.mpc.horizon import Horizon, PredictionModel, instance_of, new_horizon, prediction
from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.control.policy.kernels import network_answer
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.problem import ControlProblem, StageWeights
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.extensions.shared.loop_kernels import LoopArrays, advance_plant, ask_controller
from hybrid_sysid_ros.extensions.shared.scenarios import LoopRun, Scenario
from hybrid_sysid_ros.support.arrays import Array


def run_network(scenario: Scenario, problem: ControlProblem, policy: Policy) -> LoopRun:
    """The loop of a policy as :func:`.shared.scenarios.run` simulates it; the problem is sized."""
    plant, (periods, n), m = scenario.plant, scenario.states.shape, scenario.inputs.shape[1]
    p = scenario.references.shape[1]
    loop = LoopArrays.empty(periods, problem.horizon, n, m, p)
    scenario.write(loop)
    asked, plan = np.empty((periods, n + 2 * m + problem.horizon * p)), np.empty((policy.stages, m))
    parts = new_horizon(plant, problem), prediction(plant, problem), problem.stage_weights, scenario.begins
    _drive(*policy.packed, *parts, loop, asked, plan)
    return LoopRun(loop.states, loop.inputs, loop.costs, float(loop.excess[0]), asked)


@kernel
def _drive(
    sizes: NDArray[np.int64],
    numbers: Array,
    horizon: Horizon,
    plant: PredictionModel,
    weights: StageWeights,
    begins: NDArray[np.bool_],
    loop: LoopArrays,
    asked: Array,
    plan: Array,
) -> None:
    """Drive the plant by the plans (stages, m) of a policy, whose sizes and numbers these are; write what it is asked
    (T, n + 2 m + N p). Without an answer the previous inputs hold.
    """
    (n, m), p = horizon.linear.B.shape[1:], loop.references.shape[1]
    stage, flat = instance_of(np.empty(n + 2 * m + p), n, m, p), np.empty(asked.shape[1])
    instance = instance_of(flat, n, m, p)
    for k in range(asked.shape[0]):
        ask_controller(horizon, stage, loop, begins[k] or k == 0, k, asked[k])
        assign(flat, asked[k])
        if not network_answer(sizes, numbers, flat, plan):
            hold(horizon, instance)
            assign(plan[0], horizon.planned[0])
        advance_plant(plant, weights, stage, plan, loop, k)
