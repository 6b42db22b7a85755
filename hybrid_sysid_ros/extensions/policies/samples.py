"""Samples of an exact MPC: its answers in closed loops, driven by itself or by a policy that learns from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control import scenarios
from hybrid_sysid_ros.control.controller import Controller, MpcSolution, Status
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.scenarios import LENGTH, Scenario, Spread, magnitude
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.policies.reference_kinds import references
from hybrid_sysid_ros.support.arrays import Array

UNMOVED = 0.3
"""Share of the periods in which the MPC is asked at the state and the previous input as they are."""

LIVELY, LIVELINESS, RESTARTS = 0.5, 0.01, 0.04
"""Share of the lively loops, whose pushes have full size; size of the pushes of the quietest others, all magnitudes
between being alike, for as much is asked of a policy near rest as at full swing; share of a lively loop's periods in
which it begins anew."""

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
    costs: Array
    """(samples,), mean stage cost of its loop."""
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


def scenario_of(
    system: System, problem: ControlProblem, spread: Spread, random: np.random.Generator
) -> tuple[Scenario, Array]:
    """A scenario for training, and by how much the previous inputs (T, m) are moved before the MPC is asked.

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
    scenario = scenarios.drawn(random, system, problem, spread, wanted, begins, size=size)
    jitter = moved * random.normal(size=scenario.inputs.shape) * np.array(spread.input_jitter)
    return scenario._replace(state_errors=JITTER * moved * errors), jitter


def sample(
    system: System,
    problem: ControlProblem,
    spread: Spread,
    seed: int,
    *,
    driver: Controller | None = None,
    followed: Mapping[str, float] | None = None,
) -> TrainingSamples:
    """One closed loop in which the exact MPC is asked at each period.

    driver: who drives the loop, the MPC itself by default (DAgger: Ross, Gordon, Bagnell 2011, AISTATS). followed:
    parameters by which plans are differentiated, and their spreads, by central differences over half of them. The
    plant's parameters are spread, the MPC's are not.
    """
    random = np.random.default_rng(seed)
    problem, spread = problem.sized(system), spread.sized(system)
    scenario, jitter = scenario_of(system, problem, spread, random)
    expert = _Expert(system, problem, followed or {}, len(scenario.begins))
    low, high = np.array(problem.input_low), np.array(problem.input_high)

    def control(k: int, asked: Instance) -> Array:
        if scenario.begins[k]:
            expert.reset()
        moved = np.clip(asked.previous + jitter[k], low, high)
        plan = expert.answer(k, asked._replace(previous=moved))
        return plan.input if driver is None else driver.control(*asked).input

    loop = scenarios.run(scenario, problem, control)
    return expert.samples(float(loop.costs.mean()))


def sampled(
    system: System,
    problem: ControlProblem,
    spread: Spread,
    seed: int,
    *,
    driver: Controller | None,
    followed: Mapping[str, float],
) -> dict[str, NDArray[Any]]:
    """:func:`sample` for a process of its own: what it gives as arrays. Such a process needs no torch."""
    return sample(system, problem, spread, seed, driver=driver, followed=followed).arrays


def shifted(system: System, name: str, change: float) -> System:
    """The system with one of its parameters moved."""
    named = system.named
    return system.with_values([*(named | {name: named[name] + change}).values()])


class _Expert:
    """The exact MPC, and those of moved parameters, asked once a period; what they answered."""

    def __init__(self, system: System, problem: ControlProblem, followed: Mapping[str, float], periods: int) -> None:
        self._mpc = ExactMpc(system, problem)
        self._period = problem.period
        self._shifted = [
            [ExactMpc(shifted(system, name, side * spread), problem) for side in (-0.5, 0.5)]
            for name, spread in followed.items()
        ]
        inputs = len(system.inputs)
        size = len(system.states) + 2 * inputs + problem.horizon * len(system.outputs)
        self._kept = np.zeros(periods, dtype=bool)
        self._found = {
            "instances": np.zeros((periods, size)),
            "plans": np.zeros((periods, problem.horizon, inputs)),
            "shifts": np.zeros((periods, len(followed), problem.horizon, inputs)),
        }

    def reset(self) -> None:
        for mpc in (self._mpc, *(mpc for pair in self._shifted for mpc in pair)):
            mpc.reset()

    def answer(self, k: int, asked: Instance) -> MpcSolution:
        """The answer at period k, which is kept if it converged."""
        found = self._found
        plan = self._solved(self._mpc, asked)
        found["instances"][k] = np.concatenate([np.ravel(part) for part in asked])
        found["plans"][k] = plan.inputs
        solved = plan.status is Status.SOLVED
        self._mpc.prepare(self._period)
        for index, pair in enumerate(self._shifted):
            below, above = (self._solved(mpc, asked) for mpc in pair)
            solved &= below.status is Status.SOLVED and above.status is Status.SOLVED
            found["shifts"][k, index] = above.inputs - below.inputs
            for mpc in pair:
                mpc.prepare(self._period)
        self._kept[k] = solved
        return plan

    @staticmethod
    def _solved(mpc: ExactMpc, asked: Instance) -> MpcSolution:
        """Asked twice where that is needed: from a cold start one answer in ten takes so long."""
        plan = mpc.control(*asked)
        return plan if plan.status is Status.SOLVED else mpc.control(*asked)

    def samples(self, cost: float) -> TrainingSamples:
        """What was kept; cost: mean stage cost of the loop. One that ran away teaches nothing."""
        self._kept &= np.isfinite(cost)
        arrays = {name: values[self._kept] for name, values in self._found.items()}
        costs, dropped = np.full(int(self._kept.sum()), cost), np.array([np.sum(~self._kept)])
        return TrainingSamples(**arrays, costs=costs, dropped=dropped)
