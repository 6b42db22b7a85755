"""One closed loop of a certificate, in compiled code: the exact MPC, the network and the supervised network, each from
the same beginning and with the same draws, and the exact MPC asked beside them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.mpc.horizon import instance_of
from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.control.mpc.shooting import Shooting, cold_start, forget, shift, shooting, solve
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.online_check import ACCEPTED, WAITING, Tolerances, online_check, trial
from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import OPTIONS

Array = NDArray[np.float64]

DRIVERS = EXACT, NETWORK, SUPERVISED = range(3)
MEASURES = COST, ERROR, WORST_PERIOD, UNSOLVED, EXCESS = range(5)
"""Of a driver's loop: its cost as it went; the largest difference of its input from the exact MPC's answer to the same
question, and the period in which it was; periods in which that answer is none or not converged; and by how much a state
was outside of its bounds. An input outside of its bounds or a state that is no number makes EXCESS infinite.

The exact MPC begins at its own last plan, as when it drives. Its problem may have several local solutions, so where the
driver is off by more than it may be, it begins at the driver's plan once more, and the cheaper solution is the answer.
"""

SOLVED, UNCONVERGED, NONE = range(3)


class Draw(NamedTuple):
    """What a loop of T periods is made of; n states.

    state (n,), input (1,): at the beginning. wanted (T + horizon - 1,): reference of the output, from one period on.
    disturbances (T,): of the input. pushes (T, n): of the state, at the beginning of a period. errors (T, n + 1): of
    the estimates of state and disturbance. parameters (named), network: of the plant.
    """

    state: Array
    input: Array
    wanted: Array
    disturbances: Array
    pushes: Array
    errors: Array
    parameters: Any
    network: Array


class Solver(NamedTuple):
    """An exact MPC: the parts of its :class:`~.shooting.Shooting` that its functions take, and when to stop."""

    model: Any
    horizon: Any
    program: Any
    iterations: int
    tolerance: float


class Track(NamedTuple):
    """How a loop went: states (T + 1, n), before each period's push, and after the last one; inputs (T,), the answers
    (T,) of the exact MPC beside them, and what the check found (T,), -1 where none was made.
    """

    states: Array
    inputs: Array
    exact: Array
    reasons: NDArray[np.int64]


class Bench:
    """The memory in which one thread runs loops of a policy; see :meth:`run`.

    plant: equation of the plants, whose states are those of the model. model: equation of the exact MPC, whose KKT
    residual is below kkt_tolerance. input_error: by how much a driver may be off [drive unit].
    Raises UserError for a policy that gives its first input alone.
    """

    def __init__(
        self,
        plant: System,
        model: System,
        policy: Policy,
        tolerances: Tolerances,
        *,
        kkt_tolerance: float,
        input_error: float,
    ) -> None:
        self.policy = policy
        self.tolerances = tolerances
        self._input_error = input_error
        self._range = policy.training_range.packed
        self._trial = trial(policy)
        self._memory = [shooting(model, policy.problem) for _ in range(2)]
        self._solvers = [_solver(each, policy.problem.max_iterations, kkt_tolerance) for each in self._memory]
        self._run = closed_loop(plant, model, policy, self._memory[0])

    def run(self, draw: Draw, driver: int, measures: Array, reasons: NDArray[np.int64]) -> Track:
        """One loop: ``measures`` (measures,) and ``reasons`` (reasons,), how often the check found each, receive what
        came out.
        """
        periods = len(draw.disturbances)
        track = Track(
            np.empty((periods + 1, len(draw.state))),
            np.empty(periods),
            np.empty(periods),
            np.full(periods, -1, dtype=np.int64),
        )
        policy = self.policy
        self._trial.waiting[0] = 0
        self._run(
            driver, draw, policy.memory, self._range, self.tolerances, self._trial, *self._solvers, self._input_error,
            track, measures, reasons,
        )  # fmt: skip
        return track


def _solver(memory: Shooting, iterations: int, tolerance: float) -> Solver:
    return Solver(memory.prediction, memory.horizon, memory.program, iterations, tolerance)


@numba.njit(**OPTIONS)
def set_plan(horizon: Any, states: Array, inputs: Array) -> None:
    """Make states (horizon + 1, n) and inputs (horizon,) the plan of a horizon."""
    for i in range(states.shape[0]):
        assign(horizon.states[i], states[i])
    for i in range(inputs.shape[0]):
        assign(horizon.inputs[i], inputs[i])


_COMPILED: dict[tuple[Any, ...], Callable[..., None]] = {}


def closed_loop(plant: System, model: System, policy: Policy, mpc: Shooting) -> Callable[..., None]:
    """The compiled loop of these forms, made once in a process."""
    key = (plant.form, model.form, policy.kernels)
    if key not in _COMPILED:
        _COMPILED[key] = _compile(plant, model, policy, mpc)
    return _COMPILED[key]


def _compile(plant: System, model: System, policy: Policy, mpc: Shooting) -> Callable[..., None]:
    step_address, answer = compiled(plant).step, policy.kernels.answer
    check, follow = online_check(model, policy).check, online_check(model, policy).follow
    begin = cold_start
    states, tracked = policy.states, policy.output

    def ask(solver: Any, question: Any) -> int:
        """The exact MPC's plan for a question, into the solver's horizon; without one that stays as it was."""
        horizon = solver.horizon
        last_states, last_inputs = horizon.states.copy(), horizon.inputs.copy()
        found = solve(solver.model, horizon, solver.program, question, solver.iterations, solver.tolerance, True)
        if found.iterations == 0 or not np.isfinite(horizon.inputs).all():
            set_plan(horizon, last_states, last_inputs)
            return NONE
        return SOLVED if found.solved else UNCONVERGED

    ask = numba.njit(ask, **OPTIONS)

    def ask_again(solver: Any, question: Any, flat: Array, trial: Any) -> bool:
        """Whether the exact MPC finds a solution from the network's plan that is no costlier; if so, it is kept."""
        horizon = solver.horizon
        last_states, last_inputs = horizon.states.copy(), horizon.inputs.copy()
        scratch = np.empty_like(last_states)
        cost, _ = follow(flat, solver.model, horizon, last_inputs, scratch)
        for i in range(trial.inputs.shape[0]):
            assign(horizon.inputs[i], trial.inputs[i])
        follow(flat, solver.model, horizon, horizon.inputs, horizon.states)
        if ask(solver, question) == SOLVED:
            other, _ = follow(flat, solver.model, horizon, horizon.inputs, scratch)
            if other <= cost:
                return True
        set_plan(horizon, last_states, last_inputs)
        return False

    ask_again = numba.njit(ask_again, **OPTIONS)

    def run(
        driver: int,
        draw: Any,
        memory: Array,
        training_range: Array,
        tolerances: Any,
        trial: Any,
        judge: Any,
        own: Any,
        input_error: float,
        track: Any,
        measures: Array,
        reasons: NDArray[np.int64],
    ) -> None:
        horizon = judge.horizon
        limit, output, substeps, step = horizon.high[0], tracked, judge.model.substeps, judge.model.h
        periods, count = draw.disturbances.shape[0], horizon.inputs.shape[0]
        flat, drive, following = np.empty(states + 2 + count), np.empty(1), np.empty(states)
        question = instance_of(flat, states, 1, 1)
        x, u = draw.state.copy(), draw.input[0]
        judge_cold = own_cold = True
        forget(judge.program)  # nothing is left of the loop before
        forget(own.program)
        measures[:] = 0.0
        for k in range(periods):
            assign(track.states[k], x)
            for a in range(states):
                x[a] += draw.pushes[k, a]
                flat[a] = x[a] + draw.errors[k, a]
            flat[states] = draw.disturbances[k] + draw.errors[k, states]
            flat[states + 1] = u
            assign(flat[states + 2 :], draw.wanted[k : k + count])
            if judge_cold:
                begin(judge.model, horizon, question)
            status = ask(judge, question)
            judge_cold = judge_cold and status == NONE
            measures[UNSOLVED] += status != SOLVED
            held = min(max(u, -limit), limit)
            exact = held if judge_cold else min(max(horizon.inputs[0, 0], -limit), limit)
            given = exact
            if driver == NETWORK:
                given = trial.inputs[0, 0] if answer(flat, memory, trial.inputs) else held
            elif driver == SUPERVISED:
                reason = WAITING
                if not own_cold:
                    reason = check(flat, memory, training_range, own.model, own.horizon, tolerances, trial)
                reasons[reason] += 1
                track.reasons[k] = reason
                if reason == ACCEPTED:
                    set_plan(own.horizon, trial.states, trial.inputs)
                    own.horizon.disturbance[0] = flat[states]
                else:
                    if own_cold:
                        begin(own.model, own.horizon, question)
                    own_cold = ask(own, question) == NONE and own_cold
                given = held if own_cold else min(max(own.horizon.inputs[0, 0], -limit), limit)
                shift(own.model, own.horizon, 1.0)
            if (
                abs(given - exact) > input_error
                and answer(flat, memory, trial.inputs)
                and ask_again(judge, question, flat, trial)
            ):
                exact = min(max(horizon.inputs[0, 0], -limit), limit)
            shift(judge.model, horizon, 1.0)
            error = np.inf if status == NONE else abs(given - exact)
            if not error <= measures[ERROR]:
                measures[ERROR] = error
                measures[WORST_PERIOD] = k
            if not (abs(given) <= limit and abs(given - held) <= horizon.rate[0] + 1e-9):
                measures[EXCESS] = np.inf
            drive[0] = given + draw.disturbances[k]
            for _ in range(substeps):
                call_value(step_address, x, drive, draw.parameters, draw.network, step, 0.0, following)
                assign(x, following)
            off, change = x[output] - draw.wanted[k], given - u
            measures[COST] += horizon.weights.outputs[0, 0] * off * off
            measures[COST] += (
                horizon.weights.rates[0, 0] * change * change + horizon.weights.inputs[0, 0] * given * given
            )
            for a in range(states):
                beyond = max(x[a] - horizon.weights.high[a], horizon.weights.low[a] - x[a], 0.0)
                measures[EXCESS] = max(measures[EXCESS], beyond if np.isfinite(x[a]) else np.inf)
            track.inputs[k] = given
            track.exact[k] = exact
            u = given
        assign(track.states[periods], x)

    made: Callable[..., None] = numba.njit(run, **OPTIONS)
    return made
