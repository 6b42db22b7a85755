"""Samples of an exact MPC: its answers in closed loops, driven by itself or by a policy that learns from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.batch import MpcAnswers
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.policies.network_loop import run_network
from hybrid_sysid_ros.extensions.shared import drawn_scenarios, scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import LENGTH, Spread, magnitude
from hybrid_sysid_ros.extensions.shared.reference_kinds import references
from hybrid_sysid_ros.extensions.shared.scenarios import Scenario
from hybrid_sysid_ros.support.arrays import Array

UNMOVED = 0.3
"""Share of the periods in which the MPC is asked at the state and the previous input as they are."""

LIVELY, LIVELINESS, RESTARTS = 0.8, 0.01, 0.04
"""Share of the lively loops, whose pushes have full size: there a network is off by most; size of the pushes of the
quietest others, all magnitudes between being alike, for a policy is asked near rest, too; share of a lively loop's
periods in which it begins anew."""

STRANGE = 0.04
"""Share of the periods in which the MPC is asked with a previous input that may be anywhere, as where a loop begins: in
one loop of the vehicle's certificate in a hundred a network was off there by more than it may."""

OFTENEST = 5.0
"""How many times as many jumps of the inputs' disturbances and pushes of the state the most disturbed of the lively
loops have, all factors between being alike, as a certificate has a stratum of such loops."""

JITTER = 0.2
"""By which a state is moved before the MPC is asked, in pushes: an estimate is not the state, and what rests has an
estimated speed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingSamples:
    """Converged answers of an exact MPC: n states, m inputs, p outputs, horizon N."""

    instances: Array
    """(samples, n + 2 m + N p): [x, d, u_previous, q_1 (p,), ..., q_N (p,)]."""
    plans: Array
    """(samples, N, m)."""
    shifts: Array
    """(samples, parameters, N, m), derivatives of the plan by the followed parameters, per spread."""
    dropped: NDArray[np.int64]
    """(loops,), answers that did not converge."""

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """As they are kept on disk."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @classmethod
    def joined(cls, parts: Sequence[Mapping[str, NDArray[Any]]]) -> TrainingSamples:
        """All samples of several sets of :attr:`arrays`."""
        return cls(**{item.name: np.concatenate([part[item.name] for part in parts]) for item in fields(cls)})


def scenario_of(system: System, problem: ControlProblem, spread: Spread, random: np.random.Generator) -> Scenario:
    """A scenario for training, in which the previous inputs are moved before the MPC is asked.

    System, problem and spread are sized for each other.
    """
    periods, horizon = LENGTH * problem.horizon, problem.horizon
    lively = random.uniform() < LIVELY
    size = 1.0 if lively else magnitude(random, LIVELINESS)
    target = references(random, spread, problem)
    wanted = target(problem.period * np.arange(1, periods + horizon))
    begins = (random.uniform(size=periods) < RESTARTS) & lively
    begins[0] = True
    moved = size * (random.uniform(size=(periods, 1)) > UNMOVED)
    errors = random.normal(size=(periods, len(spread.push))) * np.array(spread.push)
    often = 1.0 / magnitude(random, 1.0 / OFTENEST) if lively else 1.0
    scenario = drawn_scenarios.drawn(random, system, problem, spread, wanted, begins, size=size, often=often)
    jitter = moved * random.normal(size=scenario.inputs.shape) * np.array(spread.input_jitter)
    strange = random.uniform(size=(periods, 1)) < STRANGE
    wide = random.uniform(-1.0, 1.0, scenario.inputs.shape) * (np.array(problem.input_high) - problem.input_low)
    input_errors = np.where(strange, wide, jitter)
    return scenario._replace(state_errors=JITTER * moved * errors, input_errors=input_errors)


def sample(
    system: System,
    problem: ControlProblem,
    spread: Spread,
    seed: int,
    *,
    driver: Policy | None = None,
    followed: Mapping[str, float] | None = None,
) -> TrainingSamples:
    """One closed loop in which the exact MPC is asked at each period.

    driver: who drives the loop, the MPC itself by default (DAgger: Ross, Gordon, Bagnell 2011, AISTATS). followed:
    parameters by which plans are differentiated, and their spreads, by central differences over half of them. The
    plant's parameters are spread, the MPC's are not.
    """
    random = np.random.default_rng(seed)
    problem, spread = problem.sized(system), spread.sized(system)
    scenario, mpc = scenario_of(system, problem, spread, random), ExactMpc(system, problem)
    # Asked twice where that is needed: from a cold start one answer in ten takes so long.
    if driver is None:
        ((loop, answers),) = scenarios.run_many(mpc, [scenario], attempts=2, threads=1)
    else:
        exact = scenario._replace(input_errors=np.zeros_like(scenario.input_errors))
        loop = run_network(exact, problem, driver)
        first, last = len(system.states) + len(system.inputs), len(system.states) + 2 * len(system.inputs)
        before = loop.asked[:, first:last] + scenario.input_errors
        loop.asked[:, first:last] = np.clip(before, problem.input_low, problem.input_high)
        answers = mpc.solve_sequence(loop.asked, scenario.begins, attempts=2)
    sound = answers.solved & np.isfinite(loop.costs).all()  # a loop that ran away teaches nothing
    return kept_samples(system, problem, loop.asked, scenario.begins, answers, sound, followed or {})


def kept_samples(
    system: System,
    problem: ControlProblem,
    asked: Array,
    begins: NDArray[np.bool_],
    answers: MpcAnswers,
    kept: NDArray[np.bool_],
    followed: Mapping[str, float],
) -> TrainingSamples:
    """The samples of answers to a sequence ``asked`` that are kept (rows,), with their derivatives by ``followed``
    parameters where both differences have answers, too.
    """
    shifts = []
    for name, deviation in followed.items():
        near = (ExactMpc(shifted(system, name, side * deviation), problem) for side in (-0.5, 0.5))
        below, above = (each.solve_sequence(asked, begins, attempts=2) for each in near)
        kept = kept & below.solved & above.solved
        shifts.append(above.inputs - below.inputs)
    return TrainingSamples(
        instances=asked[kept],
        plans=answers.inputs[kept],
        shifts=np.stack(shifts, axis=1)[kept] if shifts else np.zeros((kept.sum(), 0, *answers.inputs.shape[1:])),
        dropped=np.array([np.sum(~kept)]),
    )


def sampled(
    system: System,
    problem: ControlProblem,
    spread: Spread,
    seed: int,
    *,
    driver: Policy | None,
    followed: Mapping[str, float],
) -> dict[str, NDArray[Any]]:
    """:func:`sample` for a process of its own: what it gives as arrays. Such a process needs no torch."""
    return sample(system, problem, spread, seed, driver=driver, followed=followed).arrays


def shifted(system: System, name: str, change: float) -> System:
    """The system with one of its parameters moved."""
    named = system.named
    return system.with_values([*(named | {name: named[name] + change}).values()])
