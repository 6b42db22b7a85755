"""Samples of an exact MPC: closed loops on rich references, driven by the MPC or by a policy that learns from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid_sysid_ros.control.controller import Controller, Status
from hybrid_sysid_ros.control.mpc import ExactMpc
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.equations import Equation, kernels
from hybrid_sysid_ros.rigs.excitation import Reference, multisine, random_steps, swept_sine

Array = NDArray[np.float64]

EPISODE_SECONDS = 8.0


@dataclass(frozen=True, kw_only=True)
class Spread:
    """What the loops are made of. amplitude: of the references [output_scale units]. disturbance: deviation of the
    constant input offset [drive unit]. input_jitter: deviation by which the previous input is moved before the MPC is
    asked [drive unit], so that the policy learns its effect apart from the state's. kick: deviation of each state's
    occasional push (states,).
    """

    amplitude: float
    disturbance: float
    input_jitter: float
    kick: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """states (samples, states), disturbances (samples,), previous (samples,), previews (samples, horizon), inputs
    (samples,): the MPC's answers. Only converged answers are kept; ``dropped`` counts the others.
    """

    states: Array
    disturbances: Array
    previous: Array
    previews: Array
    inputs: Array
    dropped: int

    @classmethod
    def joined(cls, parts: list[Samples]) -> Samples:
        """All samples of several sets."""
        names = ("states", "disturbances", "previous", "previews", "inputs")
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(**arrays, dropped=sum(part.dropped for part in parts))


def reference(random: np.random.Generator, amplitude: float) -> Reference:
    """A reference of a random kind within +-amplitude, in the unit of the amplitude."""
    kind, seed = random.integers(4), int(random.integers(2**31))
    size = amplitude * random.uniform(0.2, 1.0)
    if kind == 0:
        return random_steps(seed, amplitude=amplitude, hold=random.uniform(0.3, 2.0), duration=EPISODE_SECONDS + 2)
    if kind == 1:
        high = random.uniform(0.5, 3.0)
        return multisine(seed, amplitude=size, low=0.1, high=high, lines=12, period=10.0)
    if kind == 2:
        return swept_sine(amplitude=size, low=0.1, high=random.uniform(0.3, 2.0), duration=EPISODE_SECONDS)
    offset, slope = random.uniform(-amplitude, amplitude), random.normal() * 0.3 * amplitude

    def ramp(t: ArrayLike) -> Array:
        return np.clip(offset + slope * (np.asarray(t) - EPISODE_SECONDS / 2), -amplitude, amplitude)

    return ramp


def sample(
    equation: Equation,
    problem: Problem,
    spread: Spread,
    seed: int,
    *,
    driver: Controller | None = None,
) -> Samples:
    """One closed loop of 8 s from a random state; the exact MPC answers at each period.

    driver: who drives the loop, the MPC itself by default (DAgger: Ross, Gordon, Bagnell 2011, AISTATS). The loop is
    simulated in the exact form, at the steps of the MPC's own prediction.
    """
    random = np.random.default_rng(seed)
    expert = ExactMpc(equation, problem)
    target = reference(random, spread.amplitude)
    scale, horizon = problem.output_scale, problem.horizon
    disturbance = np.array([random.normal() * spread.disturbance])
    output = equation.outputs[0]
    state = np.zeros(len(equation.states))
    state[output] = scale * (float(target(0.0)) if random.uniform() < 0.5 else random.uniform(-1, 1) * spread.amplitude)
    following = np.empty_like(state)
    advance, parameters, weights = kernels(equation).step, equation.named, equation.weights
    step = problem.period / problem.substeps
    u = random.uniform(-1.0, 1.0) * problem.input_limit
    rows: list[tuple[Array, float, float, Array, float]] = []
    dropped = 0
    for k in range(round(EPISODE_SECONDS / problem.period)):
        preview = scale * target(problem.period * (k + np.arange(1, horizon + 1)))
        if random.uniform() < 0.05:
            state = state + random.normal(size=len(state)) * np.array(spread.kick)
        moved = u if random.uniform() < 0.3 else u + random.normal() * spread.input_jitter
        previous = np.array([np.clip(moved, -problem.input_limit, problem.input_limit)])
        answer = expert.control(state, disturbance, previous, preview)
        if answer.status is Status.SOLVED:
            rows.append((state.copy(), disturbance[0], previous[0], preview, answer.input[0]))
        else:
            dropped += 1
        expert.prepare(problem.period)
        if driver is None:
            u = float(answer.input[0])
        else:
            u = float(driver.control(state, disturbance, np.array([u]), preview).input[0])
        for _ in range(problem.substeps):
            advance(state, np.array([u]) + disturbance, parameters, weights, step, following)
            state = following.copy()
    states, disturbances, lasts, previews, inputs = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    return Samples(
        states=np.reshape(states, (len(rows), len(equation.states))),
        disturbances=np.array(disturbances, dtype=float),
        previous=np.array(lasts, dtype=float),
        previews=np.reshape(previews, (len(rows), horizon)),
        inputs=np.array(inputs, dtype=float),
        dropped=dropped,
    )
