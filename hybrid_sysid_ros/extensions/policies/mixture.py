"""The mixture of closed loops that a certificate is about: its strata, and how a loop of each is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.shared import drawn_scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import LENGTH, Spread
from hybrid_sysid_ros.extensions.shared.reference_kinds import KINDS, references
from hybrid_sysid_ros.extensions.shared.scenarios import Scenario
from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.structured import numbers

APART, DISTURBED = "beginnings apart", "disturbances"
STRATA = (*KINDS, APART, DISTURBED)
"""Each has the same part of the loops. In those that are named by a kind of reference, a loop begins on it; in the last
two the reference is of any kind."""

BEGINNINGS = "pushed from the steady motion at an output, which stays as it is"
"""Where loops begin, as a certificate states it."""

OFTEN = 5.0
"""How many times as many jumps of the inputs' disturbances and pushes of the state the stratum of disturbances has."""

LATEST = 1000.0
"""Seconds after which a declared disturbance is looked at, at most: it goes on for ever."""


@dataclass(frozen=True, kw_only=True)
class Mixture:
    """What loops are made of."""

    spread: Spread
    """References, disturbances, pushes and plants, as in the training but for the jitter."""
    seconds: float
    """Length of a loop."""
    state_error: Numbers
    """(n,), deviations of the estimated states, new at every period."""
    disturbance_error: Numbers
    """(m,), deviations of the estimated input disturbance, one for a loop."""
    plant: str
    """What stands for the plant, in words."""
    declared: Mapping[str, Excitation] = field(default_factory=dict)
    """What moves states of the plant from outside, by their names."""

    def sized(self, model: System) -> Mixture:
        """With a value for each state, input and output. Raises UserError where it has another number of them."""
        n, m = len(model.states), len(model.inputs)
        return replace(
            self,
            spread=self.spread.sized(model),
            state_error=numbers(self.state_error, "certificate: state_error", count=n),
            disturbance_error=numbers(self.disturbance_error, "certificate: disturbance_error", count=m),
        )

    def scenario(self, model: System, plant: System, problem: ControlProblem, seed: int, loop: int) -> Scenario:
        """What a loop is made of; it depends on the seed and the number of the loop alone."""
        random, stratum = np.random.default_rng([seed, loop]), stratum_of(loop)
        periods = round(self.seconds / problem.period)
        target = references(random, self.spread, problem, stratum if stratum in KINDS else "")
        longest = LENGTH * problem.horizon * problem.period
        start = random.uniform(0.0, max(longest - self.seconds, 0.0))
        wanted = target(start + problem.period * np.arange(1, periods + problem.horizon))
        found = drawn_scenarios.drawn(
            random,
            model,
            problem,
            self.spread,
            wanted,
            np.arange(periods) == 0,
            plant=plant,
            apart=float(stratum == APART),
            often=OFTEN if stratum == DISTURBED else 1.0,
        )
        if stratum == DISTURBED:
            moved = self._moved(random, plant, problem, periods)
            found = found._replace(states=found.states + moved[:1], pushes=found.pushes + np.diff(moved, axis=0))
        offsets = random.normal(size=len(self.disturbance_error)) * np.array(self.disturbance_error)
        errors = random.normal(size=found.states.shape) * np.array(self.state_error)
        return found._replace(state_errors=errors, disturbance_errors=np.tile(offsets, (periods, 1)))

    def _moved(self, random: np.random.Generator, plant: System, problem: ControlProblem, periods: int) -> Array:
        """By how much each state is moved from outside (T + 1, n), before each period."""
        names = [item.name for item in plant.states]
        moved = np.zeros((periods + 1, len(names)))
        for name, excitation in self.declared.items():
            times = random.uniform(0.0, LATEST) + problem.period * np.arange(periods + 1)
            moved[:, names.index(name)] = excitation.signal(seed=int(random.integers(2**31)))(times)
        return moved


def stratum_of(loop: int) -> str:
    """That a loop belongs to, by its number."""
    return STRATA[loop % len(STRATA)]
