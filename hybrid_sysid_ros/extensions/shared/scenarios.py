"""Scenarios: closed loops of a problem that are simulated by the thousand."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.batch import MpcAnswers, in_threads
from hybrid_sysid_ros.control.mpc.horizon import Instance, prediction
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.mpc.shooting import HorizonMemory, rollout
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared.loop_kernels import LoopArrays, answer_loop
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Controls = Callable[[int, Instance], Array]
"""control(k, instance) -> inputs (m,) of period k, the controller of a loop."""


class Scenario(NamedTuple):
    """A closed loop of T periods without its controller: n states, m inputs, p outputs, horizon N."""

    plant: System
    begins: NDArray[np.bool_]
    """Whether the loop begins, or begins again, in each period, (T,)."""
    states: Array
    """Initial states in these periods, (T, n)."""
    inputs: Array
    """Previous inputs in these periods, (T, m)."""
    references: Array
    """References from one period after the beginning on, (T + N - 1, p)."""
    disturbances: Array
    """Disturbances of the inputs, (T, m)."""
    pushes: Array
    """Pushes of the state at the beginning of a period, (T, n)."""
    state_errors: Array
    """Errors of the states that the controller gets, (T, n)."""
    disturbance_errors: Array
    """Errors of the disturbances that the controller gets, (T, m)."""
    input_errors: Array
    """Errors of the previous inputs that the controller gets, (T, m); it gets them within their bounds."""

    def write(self, loop: LoopArrays) -> None:
        """Write what a loop is made of, for compiled code."""
        for name, part in self._asdict().items():
            name = {"states": "initial_states", "inputs": "initial_inputs"}.get(name, name)
            if name not in ("plant", "begins"):
                getattr(loop, name)[...] = part


class LoopRun(NamedTuple):
    """The course of a loop."""

    states: Array
    """States before each period's push, and at the end, (T + 1, n)."""
    inputs: Array
    """(T, m)."""
    costs: Array
    """(T,), the cost of each stage."""
    excess: float
    """Largest distance of a state from its bounds; infinite where one is not a number."""
    asked: Array
    """What the controller was asked, (T, n + 2 m + N p)."""


def run(scenario: Scenario, problem: ControlProblem, control: Controls) -> LoopRun:
    """Simulate a loop: the plant in the exact form, with the steps of the MPC's prediction, under ``control``."""
    plant, weights = prediction(scenario.plant, problem), problem.stage_weights
    periods, horizon = len(scenario.begins), problem.horizon
    states, inputs = np.empty((periods + 1, scenario.states.shape[1])), np.empty_like(scenario.inputs)
    costs, most, path, rows = np.empty(periods), 0.0, np.empty((2, scenario.states.shape[1])), []
    low, high = np.array(problem.input_low), np.array(problem.input_high)
    x, u = scenario.states[0], scenario.inputs[0]
    for k in range(periods):
        if scenario.begins[k]:
            x, u = scenario.states[k], scenario.inputs[k]
        states[k] = x
        x = x + scenario.pushes[k]
        asked = Instance(
            x + scenario.state_errors[k],
            scenario.disturbances[k] + scenario.disturbance_errors[k],
            np.clip(u + scenario.input_errors[k], low, high),
            scenario.references[k : k + horizon],
        )
        rows.append(np.concatenate([np.ravel(part) for part in asked]))
        inputs[k] = control(k, asked)
        stage = Instance(x, scenario.disturbances[k], u, scenario.references[k : k + 1])
        costs[k], excess = rollout(plant, weights, stage, inputs[k : k + 1], path)
        x, u = path[1].copy(), inputs[k]
        most = max(most, excess if np.isfinite(x).all() else np.inf)
    states[periods] = x
    return LoopRun(states, inputs, costs, most, np.array(rows))


def run_many(
    mpc: ExactMpc, scenarios: Iterable[Scenario], *, attempts: int = 1, threads: int = 0
) -> Iterator[tuple[LoopRun, MpcAnswers]]:
    """Loops of the exact MPC as :func:`run` simulates them, and its answers, in compiled code on several cores.

    attempts: calls in a period that is not solved. threads: 0 for one per core; they change nothing. Raises UserError
    for a plant that has other states, inputs or outputs than the MPC's system.
    """
    names = [[item.name for item in each] for each in (mpc.system.states, mpc.system.inputs, mpc.system.outputs)]
    problem, effort = mpc.problem, mpc.effort(attempts)

    def drive(own: HorizonMemory, scenario: Scenario) -> tuple[LoopRun, MpcAnswers]:
        plant, (periods, n), m = scenario.plant, scenario.states.shape, scenario.inputs.shape[1]
        if names != [[item.name for item in each] for each in (plant.states, plant.inputs, plant.outputs)]:
            raise UserError(f"loops: the plant {type(plant).__name__} has other states, inputs or outputs than the MPC")
        loop = LoopArrays.empty(periods, problem.horizon, n, m, len(names[2]))
        scenario.write(loop)
        asked = np.empty((periods, n + 2 * m + problem.horizon * len(names[2])))
        answers = MpcAnswers.empty(periods, problem.horizon, n, m)
        parts = asked, scenario.begins, answers, prediction(plant, problem), problem.stage_weights, loop
        answer_loop(own.prediction, own.horizon, own.program, effort, *parts)
        return LoopRun(loop.states, loop.inputs, loop.costs, float(loop.excess[0]), asked), answers

    return in_threads(drive, scenarios, mpc.memory, threads)
