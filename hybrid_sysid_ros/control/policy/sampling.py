"""Samples of an exact MPC: closed loops on rich references, driven by the MPC or by a policy that learns from it."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid_sysid_ros.control.controller import Controller, Plan, Status
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.adaptation import Adaptation
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.rollout import advance
from hybrid_sysid_ros.rigs.excitation import Reference, multisine, random_steps, swept_sine

Array = NDArray[np.float64]

EPISODE_SECONDS = 8.0
KICKS, CHANGES, UNMOVED = 0.05, 0.02, 0.3
"""Shares of the periods that begin with a push of the state, with another input offset, and with state and previous
input as they are."""

LIVELY, LIVELINESS, RESTARTS = 0.5, 0.01, 0.04
"""Share of the lively loops, whose pushes have full size; size of the pushes of the quietest others, all magnitudes
between being alike, for as much is asked of a policy near rest as at full swing; share of a lively loop's periods in
which it begins anew."""

JITTER = 0.2
"""By which a state is moved before the MPC is asked, in pushes: an estimate is not the state, and a beam that rests has
an estimated speed."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """What the loops are made of. amplitude: of the references [output_scale units]. disturbance: deviation of the
    input offset, which jumps now and then [drive unit]. input_jitter: deviation by which the previous input is moved
    before the MPC is asked [drive unit], so that the policy learns its effect apart from the state's. kick: deviation
    of each state's occasional push (states,). parameters: relative deviation of each physical parameter of the plant
    from the model that the MPC has.
    """

    amplitude: float
    disturbance: float
    input_jitter: float
    kick: tuple[float, ...]
    parameters: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """states (samples, states), disturbances (samples,), previous (samples,), previews (samples, horizon), inputs
    (samples, horizon): the MPC's plans. slopes (samples, states + 2 + horizon): derivatives of the first input by
    [x, d, u_previous, q], NaN where they were not taken. shifts (samples, parameters, horizon): derivatives of the plan
    by the followed parameters, per spread. costs (samples,): mean stage cost of its loop. Only
    converged answers are kept; ``dropped`` counts the others.
    """

    states: Array
    disturbances: Array
    previous: Array
    previews: Array
    inputs: Array
    slopes: Array
    shifts: Array
    costs: Array
    dropped: int

    @classmethod
    def joined(cls, parts: list[Samples]) -> Samples:
        """All samples of several sets."""
        names = [item.name for item in fields(cls) if item.name != "dropped"]
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(**arrays, dropped=sum(part.dropped for part in parts))

    def features(self, output: int) -> Array:
        """Raw features (samples, features) of the policy: [x, d, u_previous, q - y]; output: the state that is y."""
        errors = self.previews - self.states[:, output : output + 1]
        return np.column_stack([self.states, self.disturbances, self.previous, errors])

    def feature_slopes(self, output: int) -> Array:
        """Derivatives (samples, features) of the first input by the features.

        With the errors e = q - y held, y takes the reference along: d/dy = du/dy + sum_i du/dq_i.
        """
        slopes = self.slopes.copy()
        slopes[:, output] += self.slopes[:, self.states.shape[1] + 2 :].sum(axis=1)
        return slopes


def reference(random: np.random.Generator, amplitude: float) -> Reference:
    """A reference of a random kind within +-amplitude, in the unit of the amplitude."""
    kind, seed = random.integers(4), int(random.integers(2**31))
    size = amplitude * _magnitude(random, 0.2)
    if kind == 0:
        return random_steps(seed, amplitude=size, hold=random.uniform(0.3, 2.0), duration=EPISODE_SECONDS + 2)
    if kind == 1:
        high = random.uniform(0.5, 3.0)
        return multisine(seed, amplitude=size, low=0.1, high=high, lines=12, period=10.0)
    if kind == 2:
        return swept_sine(amplitude=size, low=0.1, high=random.uniform(0.3, 2.0), duration=EPISODE_SECONDS)
    offset, slope = random.uniform(-amplitude, amplitude), random.normal() * 0.5 * size

    def ramp(t: ArrayLike) -> Array:
        return np.clip(offset + slope * (np.asarray(t) - EPISODE_SECONDS / 2), -amplitude, amplitude)

    return ramp


def _solved(expert: ExactMpc, question: tuple[Array, Array, Array, Array]) -> Plan:
    """The answer, asked for twice where that is needed: from a cold start one question in ten takes so long."""
    answer = expert.control(*question)
    return answer if answer.status is Status.SOLVED else expert.control(*question)


def _push(random: np.random.Generator, spread: Spread) -> Array:
    """By how much a push of full size moves the state (states,)."""
    return random.normal(size=len(spread.kick)) * np.array(spread.kick)


def _magnitude(random: np.random.Generator, least: float) -> float:
    """A number within ``least`` and 1, all magnitudes alike."""
    return float(least ** random.uniform())


def drawn(system: System, deviation: float, random: np.random.Generator) -> System:
    """A plant near the model: each free physical parameter moved by a relative deviation, within its bounds."""
    values = [
        value if item.fixed else min(max(value * (1.0 + deviation * random.normal()), item.low), item.high)
        for item, value in zip(system.parameters, system.values, strict=True)
    ]
    return system.with_values(np.array(values, dtype=float))


def sample(
    system: System,
    problem: Problem,
    spread: Spread,
    seed: int,
    *,
    driver: Controller | None = None,
    slope_share: float = 0.0,
    adaptation: Adaptation | None = None,
) -> Samples:
    """One closed loop of 8 s from a random state; the exact MPC answers at each period.

    driver: who drives the loop, the MPC itself by default (DAgger: Ross, Gordon, Bagnell 2011, AISTATS). slope_share:
    share of the answers whose derivatives are taken. adaptation: parameters by which plans are differentiated, by
    central differences over half their spread. The plant is simulated in the exact form, at the steps of the MPC's own
    prediction; its parameters are spread, the MPC's are not.
    """
    random = np.random.default_rng(seed)
    expert = ExactMpc(system, problem)
    followed = adaptation or Adaptation()
    shifted = [
        [ExactMpc(followed.shifted(system, index, side), problem) for side in (-0.5, 0.5)]
        for index in range(len(followed.names))
    ]
    target = reference(random, spread.amplitude)
    lively = random.uniform() < LIVELY
    liveliness = 1.0 if lively else _magnitude(random, LIVELINESS)
    plant = drawn(system, spread.parameters, random)
    scale, horizon, limit, states = problem.output_scales[0], problem.horizon, problem.input_high[0], len(system.states)
    periods = round(EPISODE_SECONDS / problem.period)
    wanted = scale * target(problem.period * np.arange(1, periods + horizon + 1))
    disturbance = np.zeros(1)
    output = system.measured[0]
    following = np.empty(states)
    address, parameters, weights = compiled(plant).step, plant.values, plant.weights
    step = problem.period / problem.substeps
    kept = np.zeros(periods, dtype=bool)
    found = Samples(
        states=np.empty((periods, states)),
        disturbances=np.empty(periods),
        previous=np.empty(periods),
        previews=np.empty((periods, horizon)),
        inputs=np.empty((periods, horizon)),
        slopes=np.full((periods, states + 2 + horizon), np.nan),
        shifts=np.empty((periods, len(shifted), horizon)),
        costs=np.zeros(periods),
        dropped=0,
    )
    for k in range(periods):
        preview = wanted[k : k + horizon]
        if k == 0 or (lively and random.uniform() < RESTARTS):
            state = liveliness * _push(random, spread)
            state[output] = scale * random.uniform(-1, 1) * spread.amplitude if random.uniform() < 0.5 else preview[0]
            disturbance[0] = random.normal() * spread.disturbance
            u = random.uniform(-1.0, 1.0) * limit
            for mpc in (expert, *(mpc for pair in shifted for mpc in pair)):
                mpc.reset()
        if random.uniform() < KICKS:
            state = state + liveliness * _push(random, spread)
        if random.uniform() < CHANGES:
            disturbance[0] = random.normal() * spread.disturbance
        asked, last = state, u
        if random.uniform() > UNMOVED:
            asked = state + JITTER * liveliness * _push(random, spread)
            last = u + liveliness * random.normal() * spread.input_jitter
        question = (asked, disturbance, np.array([min(max(last, -limit), limit)]), preview[:, None])
        answer = _solved(expert, question)
        kept[k] = answer.status is Status.SOLVED
        found.states[k], found.disturbances[k], found.previous[k] = asked, disturbance[0], question[2][0]
        found.previews[k] = preview
        found.inputs[k] = answer.inputs[:, 0]
        if random.uniform() < slope_share and kept[k]:
            found.slopes[k] = expert.sensitivity()[0]
        expert.prepare(problem.period)
        for index, pair in enumerate(shifted):
            low, high = (_solved(mpc, question) for mpc in pair)
            kept[k] &= low.status is Status.SOLVED and high.status is Status.SOLVED
            found.shifts[k, index] = (high.inputs - low.inputs)[:, 0]
            for mpc in pair:
                mpc.prepare(problem.period)
        given = answer if driver is None else driver.control(asked, disturbance, np.array([u]), preview)
        found.costs[k] = problem.rate_weights[0] * (float(given.input[0]) - u) ** 2
        u = float(given.input[0])
        for _ in range(problem.substeps):
            advance(address, state, np.array([u]) + disturbance, parameters, weights, step, following)
            state = following.copy()
        found.costs[k] += problem.output_weights[0] * ((state[output] - preview[0]) / scale) ** 2
        found.costs[k] += problem.input_weights[0] * u**2
    found.costs[:] = found.costs.mean()
    arrays = {item.name: getattr(found, item.name)[kept] for item in fields(found) if item.name != "dropped"}
    return Samples(**arrays, dropped=int(np.sum(~kept)))
