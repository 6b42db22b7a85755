"""The closed loops of a certificate: who drives them, beside whom, what they are made of and what they must keep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control import scenarios
from hybrid_sysid_ros.control.controller import MpcSolution, Status
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.mpc.shooting import rollout
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.supervisor import REASONS, Supervisor, Tolerances
from hybrid_sysid_ros.control.scenarios import LENGTH, LoopRun, Scenario, Spread, SteadyMotion, steady_motion
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array, Numbers
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers

DRIVERS = EXACT, NETWORK, SUPERVISED = range(3)
JUDGED = {"network": NETWORK, "supervised": SUPERVISED}
MEASURES = COST, ERROR, WORST_PERIOD, UNSOLVED, EXCESS = range(5)
"""Of a driver's loop: its cost as it went; the largest difference of an input from the exact MPC's answer to the same
instance, in shares of the input error that is allowed, and the period in which it was; periods in which that answer is
none or not converged; and by how much a state was outside of its bounds. An input outside of its bounds or a state that
is no number makes EXCESS infinite."""

KKT_TOLERANCE = 1e-3
"""Of the exact MPC, cost per unit of the input: its inputs are then those of the solution to some thousandths."""

ROUNDING = 1e-9
"""By how much an input may be outside of its bounds [its unit]."""


@dataclass(frozen=True, kw_only=True)
class Distribution:
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


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """What a loop must keep."""

    input_error: Numbers
    """eta (m,): by how much an input may be off the exact MPC's [its unit]."""
    cost_share: float
    """By how much its cost may be above that of the exact MPC's own loop."""
    cost_floor: float
    """And by how much at any rate, for each period."""


class Driven(NamedTuple):
    """A loop of T periods, and who said what in it."""

    loop: LoopRun
    exact: Array
    """(T, m), the answers of the exact MPC beside the driver."""
    reasons: NDArray[np.int64]
    """(T,), what the online check found, -1 where none was made."""
    measures: Array
    """(measures,)."""


@dataclass(frozen=True, kw_only=True)
class Certification:
    """A policy that is certified, and by what; policy, model and spread are of the same n, m and p."""

    policy: Policy
    seal: str
    """Of the policy's folder."""
    plant: System
    """Whose states, inputs and outputs are the model's."""
    model: System
    """Of the exact MPC."""
    distribution: Distribution
    criteria: Criteria
    tolerances: Tolerances
    seed: int = 0

    def __post_init__(self) -> None:
        for kind in ("states", "inputs", "outputs"):
            plant, model = ([item.name for item in getattr(each, kind)] for each in (self.plant, self.model))
            if plant != model:
                raise UserError(f"certificate: the plant's {kind} {plant} are not the model's {model}")
        given, criteria = self.distribution, self.criteria
        n, m = len(self.model.states), len(self.model.inputs)
        distribution = replace(
            given,
            spread=given.spread.sized(self.model),
            state_error=numbers(given.state_error, "certificate: state_error", count=n),
            disturbance_error=numbers(given.disturbance_error, "certificate: disturbance_error", count=m),
        )
        eta = numbers(criteria.input_error, "certificate: input_error", count=m)
        object.__setattr__(self, "distribution", distribution)
        object.__setattr__(self, "criteria", replace(criteria, input_error=eta))

    @property
    def periods(self) -> int:
        """Of a loop."""
        return round(self.distribution.seconds / self.policy.period)

    @cached_property
    def _motion(self) -> SteadyMotion:
        return steady_motion(self.model, self.policy.problem, np.array(self.distribution.spread.centre))

    def scenario(self, loop: int) -> Scenario:
        """What a loop is made of; it depends on the seed and the number of the loop alone."""
        random = np.random.default_rng([self.seed, loop])
        problem, given, periods = self.policy.problem, self.distribution, self.periods
        spread = given.spread
        target = scenarios.references(random, spread, problem)
        longest = LENGTH * problem.horizon * problem.period
        start = random.uniform(0.0, max(longest - given.seconds, 0.0))
        wanted = target(start + problem.period * np.arange(1, periods + problem.horizon))
        offsets = random.normal(size=len(given.disturbance_error)) * np.array(given.disturbance_error)
        found = scenarios.drawn(random, self.plant, problem, spread, self._motion, wanted, np.arange(periods) == 0)
        errors = random.normal(size=found.states.shape) * np.array(given.state_error)
        return found._replace(state_errors=errors, disturbance_errors=np.tile(offsets, (periods, 1)))

    def run(self, scenario: Scenario, driver: int) -> Driven:
        """One loop of a driver."""
        return Drivers(self).run(scenario, driver)

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
                "input": rows[:, ERROR] <= 1.0,
                "bounds": rows[:, EXCESS] <= exact[:, EXCESS] + self.tolerances.violation,
                "cost": rows[:, COST] <= allowed,
            }
            found[name] = {**parts, "all": np.logical_and.reduce(list(parts.values()))}
        return found


class Drivers:
    """The controllers of a certification, which run one loop after the other; nothing is left of the loop before."""

    def __init__(self, certification: Certification) -> None:
        """Raises UserError for a policy that can't be supervised."""
        model, self._policy = certification.model, certification.policy
        self._problem = self._policy.problem
        self._input_error = np.array(certification.criteria.input_error)
        self._beside, mpc = (ExactMpc(model, self._problem, tolerance=KKT_TOLERANCE) for _ in range(2))
        self._supervisor = Supervisor(self._policy, mpc, certification.tolerances)
        names = "input_low", "input_high", "rate_limits"
        self._low, self._high, self._rates = (np.array(getattr(self._problem, name)) for name in names)

    def run(self, scenario: Scenario, driver: int) -> Driven:
        """Let a driver go beside the exact MPC, which is asked the same at each period and begins at its own last plan,
        as when it drives.
        """
        beside, own = self._beside, (None, self._policy, self._supervisor)[driver]
        exact, reasons = np.empty_like(scenario.inputs), np.full(len(scenario.begins), -1, dtype=np.int64)
        answered, solved = np.zeros(len(reasons), dtype=bool), np.zeros(len(reasons), dtype=bool)
        beside.reset()
        if own is not None:
            own.reset()

        def control(k: int, asked: Instance) -> Array:
            first = answer = beside.control(*asked)
            given = first.input
            if own is not None:
                given = own.control(*asked).input
                own.prepare(self._problem.period)
                answer = self._cheaper(asked, given, first)
            if isinstance(own, Supervisor):
                reasons[k] = own.reason
            exact[k], answered[k] = answer.input, answer.status is not Status.FAILED
            solved[k] = first.status is Status.SOLVED
            beside.prepare(self._problem.period)
            return given

        loop = scenarios.run(scenario, self._problem, control)
        errors = np.where(answered, np.max(np.abs(loop.inputs - exact) / self._input_error, axis=1), np.inf)
        worst = int(np.argmax(errors))
        excess = loop.excess if self._within(scenario.inputs[0], loop.inputs) else np.inf
        measures = np.array([loop.costs.sum(), errors[worst], worst, np.sum(~solved), excess])
        return Driven(loop, exact, reasons, measures)

    def _within(self, first: Array, inputs: Array) -> bool:
        """Whether inputs (T, m) and their changes, after the ``first`` ones (m,), are within their bounds."""
        changes = np.abs(np.diff(inputs, axis=0, prepend=np.clip(first, self._low, self._high)[None]))
        inside = np.all((self._low <= inputs) & (inputs <= self._high))
        return bool(inside and np.all(changes <= self._rates + ROUNDING))

    def _cheaper(self, asked: Instance, given: Array, first: MpcSolution) -> MpcSolution:
        """The exact MPC's answer to an instance, the ``first`` one unless a driver's inputs (m,) are off it.

        Its problem may have several local solutions, so where the driver is off by more than it may be, it begins at
        the network's plan once more, and the cheaper solution is the answer.
        """
        near = np.all(np.abs(given - first.input) <= self._input_error)
        plan = first if near and first.status is not Status.FAILED else self._policy.control(*asked)
        if plan.status is not Status.POLICY:
            return first
        horizon = self._beside.shooting.horizon
        solution = horizon.inputs.copy(), horizon.states.copy()
        cost = self._follow(asked, solution[0])[0]
        self._beside.adopt(asked.disturbance, plan.inputs, self._follow(asked, plan.inputs)[1])
        second = self._beside.control(*asked)
        if second.status is Status.SOLVED and self._follow(asked, horizon.inputs)[0] <= cost:
            return second
        self._beside.adopt(asked.disturbance, *solution)
        return first

    def _follow(self, asked: Instance, inputs: Array) -> tuple[float, Array]:
        """Cost of a plan, and the states that it leads to."""
        mpc = self._beside.shooting
        states = np.empty_like(mpc.horizon.states)
        cost, _ = rollout(mpc.prediction, mpc.horizon.weights, asked, inputs.copy(), states)
        return float(cost), states


def measured(certification: Certification, loops: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Measures (loops, drivers, measures) and reasons (loops, reasons) of the loops from .. to."""
    numbers = range(*loops)
    measures = np.zeros((len(numbers), len(DRIVERS), len(MEASURES)))
    reasons = np.zeros((len(numbers), len(REASONS)), dtype=np.int64)
    drivers = Drivers(certification)
    for row, loop in enumerate(numbers):
        scenario = certification.scenario(loop)
        for driver in DRIVERS:
            driven = drivers.run(scenario, driver)
            measures[row, driver] = driven.measures
            if driver == SUPERVISED:
                reasons[row] = np.bincount(driven.reasons, minlength=len(REASONS))
    return {"measures": measures, "reasons": reasons}
