"""Scenarios: random closed loops of a problem, for training and for certificates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.batch import LoopArrays, MpcAnswers, answer_rows, in_threads
from hybrid_sysid_ros.control.mpc.horizon import Instance, prediction
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.mpc.shooting import HorizonMemory, rollout
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System, step_with_jacobian
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers

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


def _steady(system: System, problem: ControlProblem, outputs: Array, unknown: Array) -> tuple[Array, Array]:
    """[x, u, d] of the four equations, from a first iterate, and C there."""
    tracked = [k for k, weight in enumerate(problem.output_weights) if weight > 0]
    states, inputs, wanted = len(system.states), len(system.inputs), outputs[tracked]
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
    return unknown, c


def _unmoved(a: Array, b: Array) -> Array:
    """Whether nothing moves each state, (n,)."""
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


def jacobian_at(
    system: System, problem: ControlProblem, x: Array, u: Array, *, output: bool
) -> tuple[Array, Array, Array]:
    """A step of the prediction, or the outputs, and the derivatives by states x (n,) and by inputs u (m,), with rounded
    stick-slip.
    """
    step, n = problem.period / problem.substeps, len(x)
    value, jacobian = step_with_jacobian(system, x, u, step=step, smoothing=problem.smoothing, output=output)
    return value, jacobian[:, :n], jacobian[:, n:]


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
        course = {"states": np.empty((periods + 1, n)), "inputs": np.empty((periods, m)), "costs": np.empty(periods)}
        given = {name: np.ascontiguousarray(part) for name, part in scenario._asdict().items() if name != "plant"}
        begins, excess = given.pop("begins"), np.zeros(1)
        given |= {"initial_states": given.pop("states"), "initial_inputs": given.pop("inputs")}
        asked = np.empty((periods, n + 2 * m + problem.horizon * len(names[2])))
        answers = MpcAnswers.empty(periods, problem.horizon, n, m)
        parts = asked, begins, none, (0, periods), answers, prediction(plant, problem), problem.stage_weights
        loop = LoopArrays(**given, **course, excess=excess)
        answer_rows(own.prediction, own.horizon, own.program, effort, *parts, loop)
        return LoopRun(**course, excess=float(excess[0]), asked=asked), answers

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
    shown = steady_motion(system, problem, np.array(spread.centre)).output_map * push
    hidden = np.eye(n) - np.linalg.pinv(shown) @ shown
    for k in np.flatnonzero(begins):
        states[k] = steady_motion(system, problem, outputs[k]).state + push * (hidden @ sizes[k])
    return states
