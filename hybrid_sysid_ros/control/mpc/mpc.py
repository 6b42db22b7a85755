"""Exact model predictive control: sequential quadratic programming in compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import MpcSolution, Status
from hybrid_sysid_ros.control.mpc import calls
from hybrid_sysid_ros.control.mpc.batch import PIECE, Effort, MpcAnswers, answer_rows, in_threads
from hybrid_sysid_ros.control.mpc.calls import (
    CALL,
    MpcMemory,
    adopt_call,
    forget_call,
    give_up,
    prepare_again,
    prepare_call,
    solve_call,
)
from hybrid_sysid_ros.control.mpc.horizon import Instance, new_instance
from hybrid_sysid_ros.control.mpc.sequential import LIFTED
from hybrid_sysid_ros.control.mpc.shooting import FEEDBACK, UNCHECKED, HorizonMemory, rollout, shooting
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.terms import check_hard
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

BETWEEN_LOOKS = 4
"""Iterations between two readings of the clock."""

STATUSES = {
    calls.SOLVED: Status.SOLVED,
    calls.ITERATED: Status.ITERATED,
    calls.NOT_CONVERGED: Status.NOT_CONVERGED,
    calls.FAILED: Status.FAILED,
    calls.POLICY: Status.POLICY,
    calls.HELD: Status.HELD,
}
"""Python's names of how an answer was found."""


class ExactMpc:
    """Solves the problem at every call, beginning with the last plan.

    Converged: it iterates until the KKT residual is within the tolerance. In real time: it makes one step in a call,
    and :meth:`prepare` has linearised beforehand (Diehl et al. 2002, J. Process Control 12(4)). A call then ends with a
    simulation of its plan, and makes the step anew where that costs more than predicted, unless it is not ``checked``.

    Offset-free: d is the estimated input disturbance, so that the prediction agrees with measurements at rest
    (Pannocchia & Rawlings 2003, AIChE J. 49(2)).
    """

    def __init__(
        self,
        system: System,
        problem: ControlProblem,
        *,
        real_time: bool = False,
        checked: bool = True,
        tolerance: float = 1e-6,
        time_limit: float = math.inf,
        clock: Callable[[], float] | None = None,
    ) -> None:
        """tolerance: largest KKT residual of a solution. time_limit: that of one call [s], measured by ``clock``;
        without a clock there is no limit. Raises UserError for a problem that does not fit the system.
        """
        self.system = system
        self.problem = problem.sized(system)
        self.horizon = problem.horizon
        self.period = problem.period
        self.real_time = real_time
        self.checked = checked
        self._tolerance = tolerance
        self._time_limit = time_limit
        self._clock = clock
        self._shooting = known = shooting(system, problem)
        self.compiled = MpcMemory(
            prediction=known.prediction,
            horizon=known.horizon,
            program=known.program,
            call=np.zeros(1, CALL),
            real_time=int(real_time),
            checked=int(checked),
            iterations=self.problem.max_iterations,
            tolerance=tolerance,
            interval=self.period,
        )
        self._call = self.compiled.call
        _, self.instance = new_instance(system, self.problem)
        """Of the last call."""
        give_up(self.compiled, self.instance, True)  # compiled now, not when an answer is late
        self._call["residual"] = math.inf
        self.reset()

    def __repr__(self) -> str:
        names = ", ".join(term.name for term in self.problem.terms)
        return (
            f"ExactMpc({type(self.system).__name__}: {self.horizon} intervals of {self.period:g} s"
            f"{f', terms {names}' if names else ''}{', in real time' if self.real_time else ''})"
        )

    def reset(self) -> None:
        """Forget the last plan."""
        forget_call(self.compiled)

    @property
    def iterations(self) -> int:
        """Those of the last call."""
        return int(self._call["iterations"][0])

    @property
    def residual(self) -> float:
        """KKT residual after them."""
        return float(self._call["residual"][0])

    @property
    def cold(self) -> bool:
        """Whether there is no last plan."""
        return bool(self._call["cold"][0])

    @property
    def shooting(self) -> HorizonMemory:
        """Its memory; the inputs of its horizon are the last plan, shifted by :meth:`prepare`."""
        return self._shooting

    def assign(self, **values: Any) -> None:
        """Give parameters of the stages by their names, one value for all or N: limits, prices, places of obstacles.

        They hold until they are given again. Raises UserError for an unknown name, and for values that are not numbers
        or don't cover the horizon.
        """
        self.problem.assign(self._shooting.prediction.stage, values)
        if self._call["way"][0] in (FEEDBACK, UNCHECKED):
            prepare_again(self.compiled)

    def check(self) -> None:
        """Raise UserError where hard bounds leave no input with the parameters that the stages have now."""
        known, names = self.problem, [name for name, _ in self.problem.stage_parameters]
        stage = self._shooting.prediction.stage
        check_hard(self.system, known.terms, names, stage, known.input_low, known.input_high)

    def adopt(self, disturbance: Array, inputs: Array, states: Array) -> None:
        """Take another controller's plan as the last one: inputs (N, m) and their states (N + 1, n) under an input
        disturbance (m,). Raises UserError for other shapes.
        """
        horizon = self._shooting.horizon
        parts = [np.ascontiguousarray(part, dtype=float) for part in (disturbance, inputs, states)]
        for part, own in zip(parts, (horizon.disturbance, horizon.inputs, horizon.states), strict=True):
            if part.shape != own.shape:
                raise UserError(f"adopt: a part of the plan has shape {part.shape}; it needs {own.shape}")
        adopt_call(self.compiled, *parts)

    def prepare(self, elapsed: float) -> None:
        """Shift the plan by the time until the next call [s], and in real time linearise there."""
        prepare_call(self.compiled, elapsed)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`.

        Where something is not a number, the problem has no solution, or the time is over, the answer is the rest of the
        last plan; without one it is the previous input, or zero if that is not a number either. Raises UserError for a
        part of another shape.
        """
        instance = self.instance
        instance.assign(state, disturbance, previous_input, preview)
        return self.planned(self.within_time(instance, partial(solve_call, self.compiled, instance)))

    def within_time(self, instance: Instance, call: Callable[[int, bool], int]) -> Status:
        """Let a call (iterations, anew) -> status of compiled code go on until it is answered or the time is over."""
        cold, most, share, began = self.cold, self.problem.max_iterations, self.problem.max_iterations, 0.0
        if self._clock is not None:
            began, share = self._clock(), min(LIFTED if cold else BETWEEN_LOOKS, most)
        status = STATUSES[call(share, True)]
        while status is Status.NOT_CONVERGED and self.iterations < most:
            if self._clock is not None and self._clock() - began > self._time_limit:
                status = Status.LATE
            else:
                status = STATUSES[call(min(BETWEEN_LOOKS, most - self.iterations), False)]
            if status is Status.LATE or status is Status.FAILED:
                give_up(self.compiled, instance, cold)
        return status

    def planned(self, status: Status) -> MpcSolution:
        """The plan in the horizon; without states where there is no last plan."""
        horizon = self._shooting.horizon
        inputs, states = horizon.planned.copy(), horizon.states[1:]
        known = 0 if self.cold or status is Status.HELD else len(states)
        return MpcSolution(input=inputs[0].copy(), inputs=inputs, states=states[:known].copy(), status=status)

    def memory(self) -> HorizonMemory:
        """Further memory of the same problem, for a thread of its own; the parameters of the stages are shared."""
        return replace(shooting(self.system, self.problem), prediction=self._shooting.prediction)

    def effort(self, attempts: int = 1) -> Effort:
        """What a call may take, for compiled code."""
        return Effort(self.problem.max_iterations, self._tolerance, attempts)

    def solve_many(self, instances: Array, starts: Array | None = None, *, threads: int = 0) -> MpcAnswers:
        """Answers to independent instances, until they are solved, on several cores: the same whatever ``threads`` is.

        instances (rows, n + 2 m + N p): rows [x, d, u_previous, q_1, ..., q_N], the parts of :meth:`control`. starts
        (rows, N, m): inputs to begin from, such as a neighbour's; without them each begins from its previous inputs.
        threads: 0 for one per core. The last plan of this controller stays. Raises UserError for other shapes.
        """
        return self._solve_rows(instances, None, starts, threads=threads, piece=PIECE)

    def solve_sequence(self, instances: Array, begins: NDArray[np.bool_], *, attempts: int = 1) -> MpcAnswers:
        """Answers to the instances of a loop, each from the plan before, which is shifted by an interval, but for rows
        that begin (rows,). attempts: calls for one that is not solved. See :meth:`solve_many`.
        """
        return self._solve_rows(instances, begins, None, attempts=attempts, piece=max(len(instances), 1))

    def _solve_rows(
        self,
        instances: Array,
        begins: NDArray[np.bool_] | None,
        starts: Array | None,
        *,
        piece: int,
        attempts: int = 1,
        threads: int = 1,
    ) -> MpcAnswers:
        n, m, count = len(self.system.states), len(self.system.inputs), self.horizon
        try:
            given = np.ascontiguousarray(instances, dtype=float)
            first = np.ascontiguousarray(np.zeros((0, count, m)) if starts is None else starts, dtype=float)
        except (TypeError, ValueError) as error:
            raise UserError(f"solve_many: instances and starts are arrays of numbers ({error})") from error
        rows, width = 1 if given.ndim == 1 else len(given), n + 2 * m + count * len(self.system.outputs)
        begins = np.ones(rows, np.bool_) if begins is None else begins
        for name, part, shape in (
            ("instances", given, (rows, width)),
            ("starts", first, (rows if len(first) else 0, count, m)),
        ):
            if part.shape != shape:
                raise UserError(f"solve_many: {name} have shape {part.shape}; they need {shape}")
        answers, effort = MpcAnswers.empty(rows, count, n, m), self.effort(attempts)

        def solve(own: HorizonMemory, part: tuple[int, int]) -> None:
            parts = given, begins, first, part, answers
            answer_rows(own.prediction, own.horizon, own.program, effort, *parts)

        pieces = [(at, min(at + piece, rows)) for at in range(0, rows, piece)]
        list(in_threads(solve, pieces, self.memory, threads))
        return answers

    def follow(self, inputs: Array) -> tuple[float, Array]:
        """Cost of inputs (N, m) for the last call's instance, and the states (N + 1, n) that they lead to, in the exact
        form.
        """
        mpc = self._shooting
        states = np.empty_like(mpc.horizon.states)
        cost, _ = rollout(mpc.prediction, mpc.horizon.weights, self.instance, inputs.copy(), states)
        return float(cost), states
