"""A trial of a policy: closed loops that the network and the supervised network drive, beside the exact MPC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control import scenarios
from hybrid_sysid_ros.control.controller import MpcSolution, Status
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.mpc import ExactMpc
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.safety.supervisor import REASONS, Supervisor, Tolerances
from hybrid_sysid_ros.control.scenarios import LoopRun, Scenario
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.extensions.policies.criteria import (
    DRIVERS,
    EXACT,
    MEASURES,
    SETTLED,
    SUPERVISED,
    TRACKING,
    Criteria,
)
from hybrid_sysid_ros.extensions.policies.mixture import Mixture
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

KKT_TOLERANCE = 1e-3
"""Of the exact MPC, cost per unit of the input: its inputs are then those of the solution to some thousandths."""

ROUNDING = 1e-9
"""By how much an input may be outside of its bounds [its unit]."""


class Driven(NamedTuple):
    """A loop of T periods, and who said what in it."""

    loop: LoopRun
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
        """One loop of a driver."""
        return Drivers(self).run(scenario, driver)

    def kept(self, measures: Array) -> dict[str, dict[str, NDArray[np.bool_]]]:
        """See :meth:`~.criteria.Criteria.kept`."""
        return self.criteria.kept(measures, self.periods, self.tolerances.violation)


class MpcSolve(NamedTuple):
    """What an exact MPC found: its answer, and its trajectory and working set, from which it goes on."""

    solution: MpcSolution
    inputs: Array
    states: Array
    constraints: NDArray[np.int32]


class SharingMpc(ExactMpc):
    """An exact MPC that does not solve again what another one has solved from the same plan.

    The loops of a scenario are alike until the network drives, and beside a supervisor the judge solves what its own
    exact MPC does. Solutions from other working sets differ by their rounding.
    """

    def __init__(self, system: System, problem: ControlProblem, solved: dict[bytes, MpcSolve]) -> None:
        super().__init__(system, problem, tolerance=KKT_TOLERANCE)
        self._solved = solved

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :meth:`~hybrid_sysid_ros.control.mpc.mpc.ExactMpc.control`."""
        asked = Instance(state, disturbance, previous_input, preview)
        horizon, states = self.shooting.horizon, self.shooting.program.states
        plan = b"" if self.cold else horizon.inputs.tobytes()
        key = b"".join(map(np.ndarray.tobytes, asked)) + plan
        found = self._solved.get(key)
        if found is None:
            solution = super().control(*asked)
            if solution.status is not Status.FAILED:
                self._solved[key] = MpcSolve(solution, horizon.inputs.copy(), horizon.states.copy(), states.copy())
            return solution
        self.adopt(disturbance, found.inputs, found.states)
        self._instance.assign(*asked)
        states[:] = found.constraints
        return found.solution


class Drivers:
    """The controllers of a trial, which run one loop after the other; what is left of the loops before are solutions
    of the same scenario.
    """

    def __init__(self, trial: Trial) -> None:
        """Raises UserError for a policy that can't be supervised."""
        model, self._policy = trial.model, trial.policy
        self._problem = self._policy.problem
        self._criteria = trial.criteria
        self._input_error = np.array(trial.criteria.input_error)
        self._solved: dict[bytes, MpcSolve] = {}
        self._beside, mpc = (SharingMpc(model, self._problem, self._solved) for _ in range(2))
        self._supervisor = Supervisor(self._policy, mpc, trial.tolerances)
        names = "input_low", "input_high", "rate_limits"
        self._low, self._high, self._rates = (np.array(getattr(self._problem, name)) for name in names)

    def run(self, scenario: Scenario, driver: int) -> Driven:
        """Let a driver go beside the exact MPC, which is asked the same at each period and begins at its own last plan,
        as when it drives.
        """
        beside, own = self._beside, (None, self._policy, self._supervisor)[driver]
        exact, reasons = np.empty_like(scenario.inputs), np.full(len(scenario.begins), -1, dtype=np.int64)
        answered, solved = np.zeros(len(reasons), dtype=bool), np.zeros(len(reasons), dtype=bool)
        if own is None:
            self._solved.clear()
        else:
            own.reset()
        beside.reset()

        def control(k: int, asked: Instance) -> Array:
            first = answer = beside.control(*asked)
            given = first.input
            if own is not None:
                plan = own.control(*asked)
                given = plan.input
                own.prepare(self._problem.period)
                answer = self._cheaper(asked, plan, first)
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
        outside = self._criteria.outside(loop.states[1:])
        measures = np.array([loop.costs.sum(), errors[worst], worst, np.sum(~solved), excess, *outside, 0.0])
        return Driven(loop, exact, reasons, self._tracking_errors(scenario, loop), measures)

    def _tracking_errors(self, scenario: Scenario, loop: LoopRun) -> Array:
        """Of the outputs (settled periods, p) in the last part of a loop; 0 where one is not tracked."""
        tracked = np.array(self._problem.output_weights) > 0.0
        found = [
            output_of(scenario.plant, loop.states[k + 1], loop.inputs[k] + scenario.disturbances[k])
            - scenario.references[k]
            for k in range(round(SETTLED * len(loop.inputs)), len(loop.inputs))
        ]
        return np.where(tracked, np.abs(np.array(found)), 0.0)

    def _within(self, first: Array, inputs: Array) -> bool:
        """Whether inputs (T, m) and their changes, after the ``first`` ones (m,), are within their bounds."""
        changes = np.abs(np.diff(inputs, axis=0, prepend=np.clip(first, self._low, self._high)[None]))
        inside = np.all((self._low <= inputs) & (inputs <= self._high))
        return bool(inside and np.all(changes <= self._rates + ROUNDING))

    def _cheaper(self, asked: Instance, plan: MpcSolution, first: MpcSolution) -> MpcSolution:
        """The exact MPC's answer to an instance, the ``first`` one unless a driver's plan is off it.

        Its problem may have several local solutions, so where the driver is off by more than it may be, it begins at
        the driver's plan once more, and the cheaper solution is the answer.
        """
        near = bool((np.abs(plan.input - first.input) <= self._input_error).all())
        if (near and first.status is not Status.FAILED) or plan.status is Status.HELD:
            return first
        mpc = self._beside
        solution = mpc.shooting.horizon.inputs.copy(), mpc.shooting.horizon.states.copy()
        cost = mpc.follow(solution[0])[0]
        mpc.adopt(asked.disturbance, plan.inputs, mpc.follow(plan.inputs)[1])
        second = mpc.control(*asked)
        if second.status is Status.SOLVED and mpc.follow(mpc.shooting.horizon.inputs)[0] <= cost:
            return second
        mpc.adopt(asked.disturbance, *solution)
        return first


def measured(trial: Trial, loops: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Measures (loops, drivers, measures) and reasons (loops, reasons) of the loops from .. to."""
    numbers = range(*loops)
    measures = np.zeros((len(numbers), len(DRIVERS), len(MEASURES)))
    reasons = np.zeros((len(numbers), len(REASONS)), dtype=np.int64)
    drivers, settled = Drivers(trial), np.zeros(0)
    tracked = list(trial.policy.tracked)
    allowed = np.array(trial.criteria.tracking_error)[tracked]
    for row, loop in enumerate(numbers):
        scenario = trial.scenario(loop)
        for driver in DRIVERS:
            driven = drivers.run(scenario, driver)
            measures[row, driver] = driven.measures
            settled = driven.errors if driver == EXACT else settled
            beyond = (driven.errors - settled)[:, tracked] / allowed
            measures[row, driver, TRACKING] = beyond.max() if np.isfinite(beyond).all() else np.inf
            if driver == SUPERVISED:
                reasons[row] = np.bincount(driven.reasons, minlength=len(REASONS))
    return {"measures": measures, "reasons": reasons}
