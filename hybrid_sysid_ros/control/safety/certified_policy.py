"""Who is certified, on which random closed loops, and what a loop must keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.policy.sampling import CHANGES, EPISODE_SECONDS, KICKS, Spread, drawn, reference
from hybrid_sysid_ros.control.safety.certified_loop import (
    COST,
    ERROR,
    EXACT,
    EXCESS,
    MEASURES,
    NETWORK,
    SUPERVISED,
    Bench,
    Draw,
    Track,
)
from hybrid_sysid_ros.control.safety.online_check import REASONS, Tolerances
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

JUDGED = {"network": NETWORK, "supervised": SUPERVISED}

KKT_TOLERANCE = 1e-3
"""Of the exact MPC, cost per drive unit: its inputs are then those of the solution to some millivolts."""


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """What a loop is made of. spread: references, disturbances, pushes and plants, as in the training but for the
    jitter. seconds: its length. state_error: deviations of the estimated states, new at every period (states,).
    disturbance_error: deviation of the estimated input disturbance, one for a loop [drive unit]. plant: what stands for
    the plant, in words.
    """

    spread: Spread
    seconds: float
    state_error: tuple[float, ...]
    disturbance_error: float
    plant: str


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """What a loop must keep. input_error: eta [drive unit]. cost_share: by how much its cost may be above that of the
    exact MPC's own loop. cost_floor: and by how much at any rate, for each period.
    """

    input_error: float
    cost_share: float
    cost_floor: float


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Who is certified. seal: of the policy's folder. plant: equation of the plants. model: of the exact MPC."""

    policy: Policy
    seal: str
    plant: System
    model: System
    distribution: Distribution
    criteria: Criteria
    tolerances: Tolerances
    seed: int = 0

    def __post_init__(self) -> None:
        plant, model = ([item.name for item in each.states] for each in (self.plant, self.model))
        if plant != model:
            raise UserError(f"certificate: the plant's states {plant} are not the model's {model}")
        if len(self.distribution.state_error) != len(model) or len(self.distribution.spread.kick) != len(model):
            raise UserError(f"certificate: state_error and kick need {len(model)} numbers each, one for each state")

    @property
    def periods(self) -> int:
        """Of a loop."""
        return round(self.distribution.seconds / self.policy.problem.period)

    def bench(self) -> Bench:
        """A thread's own memory."""
        return Bench(
            self.plant,
            self.model,
            self.policy,
            self.tolerances,
            kkt_tolerance=KKT_TOLERANCE,
            input_error=self.criteria.input_error,
        )

    def draw(self, loop: int) -> Draw:
        """What a loop is made of; it depends on the seed and the number of the loop alone."""
        random = np.random.default_rng([self.seed, loop])
        problem, given = self.policy.problem, self.distribution
        spread, scale, states = given.spread, problem.output_scales[0], self.policy.states
        periods = self.periods
        target = reference(random, spread.amplitude)
        plant = drawn(self.plant, spread.parameters, random)
        start = random.uniform(0.0, max(EPISODE_SECONDS - given.seconds, 0.0))
        wanted = scale * target(start + problem.period * np.arange(1, periods + problem.horizon))
        state = random.normal(size=states) * np.array(spread.kick)
        begin = float(target(start)) if random.uniform() < 0.5 else random.uniform(-1.0, 1.0) * spread.amplitude
        state[self.policy.output] = scale * begin
        changes = random.uniform(size=periods) < CHANGES
        levels = random.normal(size=periods) * spread.disturbance
        changes[0] = True
        disturbances = levels[np.maximum.accumulate(np.where(changes, np.arange(periods), 0))]
        kicked = random.uniform(size=(periods, 1)) < KICKS
        return Draw(
            state=state,
            input=random.uniform(-1.0, 1.0, 1) * problem.input_high[0],
            wanted=wanted,
            disturbances=disturbances,
            pushes=np.where(kicked, random.normal(size=(periods, states)) * np.array(spread.kick), 0.0),
            errors=np.column_stack(
                [
                    random.normal(size=(periods, states)) * np.array(given.state_error),
                    np.full(periods, random.normal() * given.disturbance_error),
                ]
            ),
            parameters=plant.values,
            network=plant.weights,
        )

    def run(self, bench: Bench, loop: int, measures: Array, reasons: NDArray[np.int64]) -> None:
        """All drivers of a loop: ``measures`` (drivers, measures) and ``reasons`` (reasons,) receive what came out."""
        draw = self.draw(loop)
        bench.run(draw, EXACT, measures[EXACT], reasons)
        bench.run(draw, SUPERVISED, measures[SUPERVISED], reasons)
        bench.run(draw, NETWORK, measures[NETWORK], reasons)

    def again(self, loop: int, driver: str) -> tuple[Draw, Track]:
        """One loop of a driver (exact, network, supervised) run again, with how it went."""
        drivers = {"exact": EXACT, **JUDGED}
        draw = self.draw(loop)
        nothing = np.zeros(len(MEASURES)), np.zeros(len(REASONS), np.int64)
        return draw, self.bench().run(draw, drivers[driver], *nothing)

    def kept(self, measures: Array) -> dict[str, dict[str, NDArray[np.bool_]]]:
        """Which loops keep each criterion, by driver: the input within eta of the exact MPC's at every period, bounds,
        the cost of the loop, and all of these; measures (loops, drivers, measures).
        """
        criteria, periods = self.criteria, self.periods
        exact = measures[:, EXACT]
        allowed = (1.0 + criteria.cost_share) * exact[:, COST] + criteria.cost_floor * periods
        found = {}
        for name, driver in JUDGED.items():
            rows = measures[:, driver]
            parts = {
                "input": rows[:, ERROR] <= criteria.input_error,
                "bounds": rows[:, EXCESS] <= exact[:, EXCESS] + self.tolerances.violation,
                "cost": rows[:, COST] <= allowed,
            }
            found[name] = {**parts, "all": np.logical_and.reduce(list(parts.values()))}
        return found
