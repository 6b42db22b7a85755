"""A trial of a policy: closed loops that the network and the supervised network drive, beside the exact MPC."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.horizon import prediction
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.supervisor import REASONS, Supervisor, Tolerances
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.policies.criteria import (
    DRIVERS,
    EXACT,
    MEASURES,
    NETWORK,
    SETTLED,
    SUPERVISED,
    TRACKING,
    Criteria,
)
from hybrid_sysid_ros.extensions.policies.mixture import Mixture
from hybrid_sysid_ros.extensions.policies.solved_instances import SolvedInstances
from hybrid_sysid_ros.extensions.policies.trial_kernels import TrialLoop, drive
from hybrid_sysid_ros.extensions.shared.loop_kernels import LoopArrays
from hybrid_sysid_ros.extensions.shared.scenarios import Scenario
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

KKT_TOLERANCE = 1e-3
"""Of the exact MPC, cost per unit of the input: its inputs are then those of the solution to some thousandths."""

ROUNDING = 1e-9
"""By how much an input may be outside of its bounds [its unit]."""


class Courses(NamedTuple):
    """Loops of T periods as they went; n states, m inputs, p outputs."""

    states: Array
    """(loops, T + 1, n), before each period's push, and at the end."""
    inputs: Array
    """(loops, T, m)."""
    exact: Array
    """(loops, T, m), the answers of the exact MPC beside the driver."""
    outputs: Array
    """(loops, T, p), at the end of each period."""
    references: Array
    """(loops, T, p), of these."""
    costs: Array
    """(loops, T)."""
    reasons: NDArray[np.int64]
    """(loops, T), what the online check found, -1 where none was made."""
    answered: NDArray[np.bool_]
    """(loops, T), whether there is such an answer."""
    solutions: NDArray[np.bool_]
    """(loops, T), whether it is converged."""
    excess: Array
    """(loops, 1), largest distance of a state from its bounds."""
    first: Array
    """(loops, m), the inputs before."""


class Driven(NamedTuple):
    """A loop of T periods, and who said what in it."""

    states: Array
    """(T + 1, n), before each period's push, and at the end."""
    inputs: Array
    """(T, m)."""
    exact: Array
    """(T, m), the answers of the exact MPC beside the driver."""
    reasons: NDArray[np.int64]
    """(T,), what the online check found, -1 where none was made."""
    errors: Array
    """(settled periods, p): tracking errors of the tracked outputs, after each of the last periods."""
    measures: Array
    """(measures,), but for TRACKING, which takes the exact MPC's own loop."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A policy that is tried beside the exact MPC, and by what; all parts are of the same n, m and p."""

    policy: Policy
    seal: str
    """Of the policy's folder."""
    plant: System
    """Whose states, inputs and outputs are the model's."""
    model: System
    """Of the exact MPC."""
    mixture: Mixture
    criteria: Criteria
    tolerances: Tolerances
    seed: int = 0

    def __post_init__(self) -> None:
        for kind in ("states", "inputs", "outputs"):
            plant, model = ([item.name for item in getattr(each, kind)] for each in (self.plant, self.model))
            if plant != model:
                raise UserError(f"certificate: the plant's {kind} {plant} are not the model's {model}")
        object.__setattr__(self, "mixture", self.mixture.sized(self.model))
        object.__setattr__(self, "criteria", self.criteria.sized(self.model))

    @property
    def periods(self) -> int:
        """Of a loop."""
        return round(self.mixture.seconds / self.policy.period)

    def scenario(self, loop: int) -> Scenario:
        """What a loop is made of; it depends on the seed and the number of the loop alone."""
        return self.mixture.scenario(self.model, self.plant, self.policy.problem, self.seed, loop)

    def run(self, scenario: Scenario, driver: int) -> Driven:
        """One loop of a driver, as in a certificate."""
        drivers = Drivers(self)
        if driver == NETWORK:
            drivers.run(scenario, EXACT)
        return drivers.run(scenario, driver)

    def kept(self, measures: Array) -> dict[str, dict[str, NDArray[np.bool_]]]:
        """See :meth:`~.criteria.Criteria.kept`."""
        return self.criteria.kept(measures, self.periods, self.tolerances.violation)


class Drivers:
    """The controllers of a trial in compiled code, which run one loop after the other; what is left of the loops before
    are solutions of the same scenario.
    """

    def __init__(self, trial: Trial) -> None:
        """Raises UserError for a policy that can't be supervised."""
        model, problem = trial.model, trial.policy.problem
        self._trial, self._problem = trial, problem
        judge, mpc = (ExactMpc(model, problem, tolerance=KKT_TOLERANCE) for _ in range(2))
        supervisor = Supervisor(trial.policy, mpc, trial.tolerances)
        self._kept = judge, supervisor  # compiled code has no references to their memory
        n, m, p = len(model.states), len(model.inputs), len(model.outputs)
        count, periods = problem.horizon, trial.periods
        beside, size = judge.compiled, n + 2 * m + count * p
        known = prediction(trial.plant, problem)
        self._loop = TrialLoop(
            beside=beside,
            supervision=supervisor.compiled,
            solved=SolvedInstances.empty(len(DRIVERS) * 2 * periods, beside, size),
            plant=replace(known, parameters=known.parameters.copy()),
            weights=problem.stage_weights,
            course=LoopArrays.empty(periods, count, n, m, p),
            asked=np.zeros(size),
            stage=np.zeros(n + 2 * m + p),
            input_error=np.array(trial.criteria.input_error),
            **{name: np.zeros((count, m)) for name in ("inputs", "first", "kept_inputs")},
            kept_states=np.zeros((count + 1, n)),
            own_inputs=np.full((periods, count, m), np.nan),
            own_states=np.zeros((periods, count + 1, n)),
            own_constraints=np.zeros((periods, len(beside.program.states)), np.int32),
            exact=np.zeros((periods, m)),
            answered=np.zeros(periods, np.bool_),
            solutions=np.zeros(periods, np.bool_),
            reasons=np.zeros(periods, np.int64),
            outputs=np.zeros((periods, p)),
        )
        loop, course = self._loop, self._loop.course
        self._parts = Courses(
            states=course.states,
            inputs=course.inputs,
            exact=loop.exact,
            outputs=loop.outputs,
            references=course.references[:periods],
            costs=course.costs,
            reasons=loop.reasons,
            answered=loop.answered,
            solutions=loop.solutions,
            excess=course.excess,
            first=course.initial_inputs[0],
        )
        names = "input_low", "input_high", "rate_limits"
        self._low, self._high, self._rates = (np.array(getattr(problem, name)) for name in names)
        self._tracked = np.array(problem.output_weights) > 0.0
        self._settled = round(SETTLED * periods)

    def run(self, scenario: Scenario, driver: int) -> Driven:
        """Let a driver go beside the exact MPC, which is asked the same at each period. The exact MPC's own loop comes
        first.
        """
        kept = self.courses(1)
        self.begin(scenario)
        self.record(driver, kept, 0)
        errors, measures = self.measures(kept)
        return Driven(kept.states[0], kept.inputs[0], kept.exact[0], kept.reasons[0], errors[0], measures[0])

    def begin(self, scenario: Scenario) -> None:
        """Take a scenario for the loops to come."""
        scenario.write(self._loop.course)
        self._loop.plant.parameters[:] = scenario.plant.values

    def record(self, driver: int, kept: Courses, row: int) -> None:
        """Run the loop of a driver and keep its course in a row."""
        drive(self._loop, driver, self._problem.period)
        for own, part in zip(kept, self._parts, strict=True):
            own[row] = part

    def courses(self, loops: int) -> Courses:
        """Room for some loops."""
        return Courses(*(np.empty((loops, *part.shape), part.dtype) for part in self._parts))

    def measures(self, kept: Courses) -> tuple[Array, Array]:
        """Tracking errors (loops, settled periods, p) and measures (loops, measures), but for TRACKING."""
        apart = np.max(np.abs(kept.inputs - kept.exact) / self._loop.input_error, axis=2)
        errors, rows = np.where(kept.answered, apart, np.inf), np.arange(len(apart))
        worst = np.argmax(errors, axis=1)
        excess = np.where(self._within(kept), kept.excess[:, 0], np.inf)
        outside = np.array([self._trial.criteria.outside(states[1:]) for states in kept.states]).T
        unsolved = np.sum(~kept.solutions, axis=1)
        found = [kept.costs.sum(axis=1), errors[rows, worst], worst, unsolved, excess, *outside, np.zeros(len(rows))]
        off = np.abs(kept.outputs - kept.references)[:, self._settled :]
        return np.where(self._tracked, off, 0.0), np.column_stack(found)

    def _within(self, kept: Courses) -> NDArray[np.bool_]:
        """Whether inputs and their changes, after the first ones, are within their bounds, (loops,)."""
        first, axes = np.clip(kept.first, self._low, self._high)[:, None], (1, 2)
        changes = np.abs(np.diff(kept.inputs, axis=1, prepend=first))
        inside = np.all((self._low <= kept.inputs) & (kept.inputs <= self._high), axis=axes)
        return inside & np.all(changes <= self._rates + ROUNDING, axis=axes)


def measured(trial: Trial, loops: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Measures (loops, drivers, measures) and reasons (loops, reasons) of the loops from .. to."""
    numbers, drivers = range(*loops), Drivers(trial)
    measures = np.zeros((len(numbers), len(DRIVERS), len(MEASURES)))
    kept = [drivers.courses(len(numbers)) for _ in DRIVERS]
    for row, loop in enumerate(numbers):
        drivers.begin(trial.scenario(loop))
        for driver in DRIVERS:
            drivers.record(driver, kept[driver], row)
    tracked, settled = list(trial.policy.tracked), np.zeros(0)
    allowed = np.array(trial.criteria.tracking_error)[tracked]
    for driver in DRIVERS:
        errors, measures[:, driver] = drivers.measures(kept[driver])
        settled = errors if driver == EXACT else settled
        beyond = (errors - settled)[:, :, tracked] / allowed
        sound = np.isfinite(beyond).all(axis=(1, 2))
        measures[:, driver, TRACKING] = np.where(sound, beyond.max(axis=(1, 2)), np.inf)
    counts = [np.bincount(found, minlength=len(REASONS)) for found in kept[SUPERVISED].reasons]
    return {"measures": measures, "reasons": np.array(counts, dtype=np.int64).reshape(-1, len(REASONS))}
