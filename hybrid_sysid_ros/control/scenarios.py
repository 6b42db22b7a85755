"""Scenarios: random closed loops of a problem, for training and for certificates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.batch import LoopArrays, MpcAnswers, answer_rows, in_threads
from hybrid_sysid_ros.control.mpc.horizon import Instance, prediction
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.mpc.shooting import HorizonMemory, rollout
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.steady_motion import output_map_at, steady_motion
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers

Controls = Callable[[int, Instance], Array]
"""control(k, instance) -> inputs (m,) of period k, the controller of a loop."""

PUSHED, DISTURBED = 0.05, 0.02
"""Shares of the periods that begin with a push of the state, and with a new input disturbance."""

LENGTH = 20
"""Length of a training loop, in horizons."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Distribution of scenarios in SI units, with a value for each output, input or state; one value stands for all."""

    amplitude: Numbers
    """Amplitude of the references around their centre, (p,)."""
    disturbance: Numbers
    """Deviation of the input disturbance, which jumps at random times, (m,)."""
    push: Numbers
    """Deviation of each state's random pushes, (n,)."""
    input_jitter: Numbers = (0.0,)
    """Deviation that is added to the previous input before the MPC answers in the training, so that the policy learns
    its effect separately from the state's, (m,)."""
    parameters: float = 0.0
    """Relative deviation of each free physical parameter of the plant from the model that the MPC has."""
    centre: Numbers = (0.0,)
    """Centre of the references, (p,)."""

    def __post_init__(self) -> None:
        for name in ("amplitude", "disturbance", "push", "input_jitter", "parameters", "centre"):
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=float))
            if values.ndim != 1 or not np.all(np.isfinite(values)) or (name != "centre" and np.any(values < 0)):
                raise UserError(f"policy_training: {name} is {getattr(self, name)}; it needs numbers not below 0")
            object.__setattr__(self, name, float(values[0]) if name == "parameters" else tuple(values.tolist()))

    def sized(self, system: System) -> Spread:
        """The spread with a value for each output, input and state. Raises UserError for another number of values."""
        n, m, p = len(system.states), len(system.inputs), len(system.outputs)
        counts = {"amplitude": p, "centre": p, "disturbance": m, "input_jitter": m, "push": n}
        sized = {
            name: numbers(getattr(self, name), f"policy_training: {name}", count=count)
            for name, count in counts.items()
        }
        return Spread(parameters=self.parameters, **sized)


class Scenario(NamedTuple):
    """A random closed loop of T periods without its controller: n states, m inputs, p outputs, horizon N."""

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
    none = np.zeros((0, problem.horizon, len(names[1])))

    def drive(own: HorizonMemory, scenario: Scenario) -> tuple[LoopRun, MpcAnswers]:
        plant, (periods, n), m = scenario.plant, scenario.states.shape, scenario.inputs.shape[1]
        if names != [[item.name for item in each] for each in (plant.states, plant.inputs, plant.outputs)]:
            raise UserError(f"loops: the plant {type(plant).__name__} has other states, inputs or outputs than the MPC")
        loop = LoopArrays.empty(periods, problem.horizon, n, m, len(names[2]))
        scenario.write(loop)
        asked = np.empty((periods, n + 2 * m + problem.horizon * len(names[2])))
        answers = MpcAnswers.empty(periods, problem.horizon, n, m)
        parts = asked, scenario.begins, none, (0, periods), answers, prediction(plant, problem), problem.stage_weights
        answer_rows(own.prediction, own.horizon, own.program, effort, *parts, loop)
        return LoopRun(loop.states, loop.inputs, loop.costs, float(loop.excess[0]), asked), answers

    return in_threads(drive, scenarios, mpc.memory, threads)


# Parts of scenarios


def drawn(
    random: np.random.Generator,
    system: System,
    problem: ControlProblem,
    spread: Spread,
    wanted: Array,
    begins: NDArray[np.bool_],
    *,
    plant: System | None = None,
    size: float = 1.0,
    apart: float = 0.5,
    often: float = 1.0,
) -> Scenario:
    """A scenario along references ``wanted`` (T + N - 1, p) whose controller gets exact states and disturbances.

    The plant is near ``plant``, by default the system, initial states are near the system's steady motions, a share
    ``apart`` of them anywhere, previous inputs anywhere within their bounds. Disturbances jump at random times and
    where the loop begins. The state is pushed in a share of the periods, by ``size`` times the spread's pushes. often:
    factor of the shares of periods with jumps and pushes.
    """
    periods, (n, m) = len(begins), (len(spread.push), len(spread.disturbance))
    plant = plant_near(plant or system, spread.parameters, random)
    states = beginnings(random, system, problem, spread, wanted[:periods], begins, size=size, apart=apart)
    low, high = np.array(problem.input_low), np.array(problem.input_high)
    inputs = low + (high - low) * random.uniform(size=(periods, m))
    jumps = begins | (random.uniform(size=periods) < often * DISTURBED)
    levels = random.normal(size=(periods, m)) * np.array(spread.disturbance)
    pushed = random.uniform(size=(periods, 1)) < often * PUSHED
    pushes = size * np.where(pushed, random.normal(size=(periods, n)) * np.array(spread.push), 0.0)
    return Scenario(
        plant=plant,
        begins=begins,
        states=states,
        inputs=inputs,
        references=wanted,
        disturbances=levels[np.maximum.accumulate(np.where(jumps, np.arange(periods), 0))],
        pushes=pushes,
        state_errors=np.zeros((periods, n)),
        disturbance_errors=np.zeros((periods, m)),
        input_errors=np.zeros((periods, m)),
    )


def magnitude(random: np.random.Generator, least: float) -> float:
    """A random number from ``least`` to 1, with a uniform logarithm."""
    return float(least ** random.uniform())


def plant_near(system: System, deviation: float, random: np.random.Generator) -> System:
    """A plant near the model: each free physical parameter is changed by a relative deviation, within its bounds."""
    values = [
        value if item.fixed else min(max(value * (1.0 + deviation * random.normal()), item.low), item.high)
        for item, value in zip(system.parameters, system.values, strict=True)
    ]
    return system.with_values(np.array(values, dtype=float))


def beginnings(
    random: np.random.Generator,
    system: System,
    problem: ControlProblem,
    spread: Spread,
    wanted: Array,
    begins: NDArray[np.bool_],
    *,
    size: float = 1.0,
    apart: float = 0.5,
) -> Array:
    """Initial states (T, n) in the periods that begin, 0 in the others: pushed by ``size`` from the steady motion at an
    output, a share ``apart`` of them anywhere, the others at the references ``wanted`` (T, p).

    Of the push is left what the tracked outputs don't show, so that these are as drawn.
    """
    periods, n = len(wanted), len(spread.push)
    anywhere = np.array(spread.centre) + random.uniform(-1.0, 1.0, wanted.shape) * np.array(spread.amplitude)
    at_reference = random.uniform(size=(periods, 1)) >= apart
    outputs, states = np.where(at_reference, wanted, anywhere), np.zeros((periods, n))
    sizes, push = size * random.normal(size=(periods, n)), np.array(spread.push)
    shown = output_map_at(system, problem, np.array(spread.centre)) * push
    hidden = np.eye(n) - np.linalg.pinv(shown) @ shown
    for k in np.flatnonzero(begins):
        states[k] = steady_motion(system, problem, outputs[k]).state + push * (hidden @ sizes[k])
    return states
