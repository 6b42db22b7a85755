"""Drawn scenarios: random closed loops of a rig's problem, by its section policy_training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared.scenarios import Scenario
from hybrid_sysid_ros.extensions.shared.steady_motion import output_map_at, steady_motion
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import AT_FIRST, in_si, listed, offset_drifts
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers

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


def spread_of(rig: Rig, model: System | None = None) -> Spread:
    """Distribution of the closed loops for a policy's training, from the rig's section policy_training.

    model: the model whose states are pushed, by default the rig's system. Raises UserError for a missing number.
    """
    given, where = rig.section("policy_training"), f"{rig.file}: policy_training"
    system = rig.system
    return Spread(
        amplitude=in_si(listed(given, "amplitude", where, len(system.outputs)), rig),
        disturbance=listed(given, "disturbance", where, len(system.inputs)),
        input_jitter=listed(given, "input_jitter", where, len(system.inputs)),
        push=by_state(listed(given, "push", where, len(system.states)), rig, model or system),
        parameters=numbers(given.get("parameters", 0.0), f"{where}.parameters", count=1)[0],
    )


def by_state(values: Sequence[float], rig: Rig, model: System) -> tuple[float, ...]:
    """Numbers of the rig's states for the states of a model, by their names. States that only the model has get 0, and
    offsets their initial deviation in an estimator.
    """
    known = dict(zip((item.name for item in rig.system.states), values, strict=True))
    known |= {name: AT_FIRST * drift for name, drift in offset_drifts(rig).items()}
    return tuple(known.get(item.name, 0.0) for item in model.states)


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
