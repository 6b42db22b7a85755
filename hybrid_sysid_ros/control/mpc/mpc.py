"""Exact model predictive control: sequential quadratic programming in compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import MpcSolution, Status, held
from hybrid_sysid_ros.control.mpc.batch import PIECE, Effort, LoopArrays, MpcAnswers, answer_rows, in_threads
from hybrid_sysid_ros.control.mpc.calls import CALL, MpcMemory
from hybrid_sysid_ros.control.mpc.horizon import new_instance
from hybrid_sysid_ros.control.mpc.quadratic_program import factorise
from hybrid_sysid_ros.control.mpc.shooting import (
    HorizonMemory,
    forget,
    plan,
    prepare_program,
    restore,
    rollout,
    shift,
    shooting,
    solve_call,
)
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

BETWEEN_LOOKS = 4
"""Iterations between two readings of the clock."""


class ExactMpc:
    """Solves the problem at every call, beginning with the last plan.

    Converged: it iterates until the KKT residual is within the tolerance. In real time: it makes one step in a call,
    and :meth:`prepare` has linearised beforehand (Diehl et al. 2002, J. Process Control 12(4)).

    Offset-free: d is the estimated input disturbance, so that the prediction agrees with measurements at rest
    (Pannocchia & Rawlings 2003, AIChE J. 49(2)).
    """

    def __init__(
        self,
        system: System,
        problem: ControlProblem,
        *,
        real_time: bool = False,
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
        self._tolerance = tolerance
        self._time_limit = time_limit
        self._clock = clock
        self._shooting = shooting(system, problem)
        _, self._instance = new_instance(system, self.problem)
        self.iterations = 0
        self.residual = math.inf
        # Compile now what only a late answer needs, not when it is late.
        restore(self._shooting.horizon, self._shooting.program)
        plan(self._shooting.horizon, self._instance)
        self.reset()

    def reset(self) -> None:
        """Forget the last plan."""
        forget(self._shooting.program)
        self._cold = True
        self._prepared = False

    @property
    def cold(self) -> bool:
        """Whether there is no last plan."""
        return self._cold

    @property
    def shooting(self) -> HorizonMemory:
        """Its memory; the inputs of its horizon are the last plan, shifted by :meth:`prepare`."""
        return self._shooting

    @cached_property
    def compiled(self) -> MpcMemory:
        """The same exact MPC for compiled code, which remembers its own last call."""
        call = np.zeros(1, CALL)
        call["cold"] = 1
        return MpcMemory(
            prediction=self._shooting.prediction,
            horizon=self._shooting.horizon,
            program=self._shooting.program,
            call=call,
            real_time=int(self.real_time),
            iterations=self.problem.max_iterations,
            tolerance=self._tolerance,
            interval=self.period,
        )

    def assign(self, **values: Any) -> None:
        """Give parameters of the stages by their names, one value for all or N: limits, prices, places of obstacles.

        They hold until they are given again. Raises UserError for an unknown name, and for values that are not numbers
        or don't cover the horizon.
        """
        self.problem.assign(self._shooting.prediction.stage, values)
        if self._prepared:
            self._prepare_program()

    def adopt(self, disturbance: Array, inputs: Array, states: Array) -> None:
        """Take another controller's plan as the last one: inputs (N, m) and their states (N + 1, n) under an input
        disturbance (m,).
        """
        horizon = self._shooting.horizon
        horizon.disturbance[:], horizon.inputs[:], horizon.states[:] = disturbance, inputs, states
        self._cold = self._prepared = False

    def prepare(self, elapsed: float) -> None:
        """Shift the plan by the time until the next call [s], and in real time linearise there."""
        if self._cold:
            return
        mpc = self._shooting
        shift(mpc.prediction, mpc.horizon, min(elapsed / self.period, 1.0))
        if self.real_time:
            self._prepare_program()

    def _prepare_program(self) -> None:
        mpc = self._shooting
        prepare_program(mpc.prediction, mpc.horizon, mpc.program)
        self._prepared = factorise(mpc.program)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`.

        Where something is not a number, the problem has no solution, or the time is over, the answer is the rest of the
        last plan; without one it is the previous input, or zero if that is not a number either. Raises UserError for a
        part of another shape, where there is no last plan.
        """
        mpc, instance = self._shooting, self._instance
        if self._cold:  # once: a loop's later calls have the shapes of its first
            instance.check(state, disturbance, previous_input, preview)
        instance.assign(state, disturbance, previous_input, preview)
        iterate = self.real_time and self._prepared and not self._cold
        self._prepared = False
        most, share = self.problem.max_iterations, self.problem.max_iterations
        began = 0.0
        if self._clock is not None:
            began, share = self._clock(), min(BETWEEN_LOOKS, most)
        parts = mpc.prediction, mpc.horizon, mpc.program, instance
        found = solve_call(*parts, share, self._tolerance, self._cold, iterate, True)
        self.iterations, self.residual = found.iterations, found.residual
        if not found.iterations:
            return self._rest(Status.FAILED)
        status = Status.SOLVED if found.solved else Status.ITERATED if iterate else Status.NOT_CONVERGED
        if status is Status.NOT_CONVERGED and self.iterations < most:
            status = self._go_on(began)
        if status is Status.FAILED or status is Status.LATE:
            restore(mpc.horizon, mpc.program)
            return self._rest(status)
        self._cold = False
        return self._planned(status)

    def step(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Array | None:
        """The first inputs (m,) after one step from the last plan, linearised there unless :meth:`prepare` has; None
        where the program has no solution. That step is the last plan then.
        """
        mpc = self._shooting
        if not self._prepared:
            self._prepare_program()
            if not self._prepared:
                return None
        self._prepared = False
        self._instance.assign(state, disturbance, previous_input, preview)
        parts = mpc.prediction, mpc.horizon, mpc.program, self._instance
        found = solve_call(*parts, 1, self._tolerance, False, True, True)
        return mpc.horizon.planned[0].copy() if found.iterations else None

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
        return self._solve_rows(instances, np.ones(len(instances), np.bool_), starts, threads=threads, piece=PIECE)

    def solve_sequence(self, instances: Array, begins: NDArray[np.bool_], *, attempts: int = 1) -> MpcAnswers:
        """Answers to the instances of a loop, each from the plan before, which is shifted by an interval, but for rows
        that begin (rows,). attempts: calls for one that is not solved. See :meth:`solve_many`.
        """
        return self._solve_rows(instances, begins, None, attempts=attempts, piece=max(len(instances), 1))

    def _solve_rows(
        self,
        instances: Array,
        begins: NDArray[np.bool_],
        starts: Array | None,
        *,
        piece: int,
        attempts: int = 1,
        threads: int = 1,
    ) -> MpcAnswers:
        n, m, count = len(self.system.states), len(self.system.inputs), self.horizon
        given = np.ascontiguousarray(instances, dtype=float)
        first = np.ascontiguousarray(np.zeros((0, count, m)) if starts is None else starts, dtype=float)
        rows, width = len(given), n + 2 * m + count * len(self.system.outputs)
        for name, part, shape in (
            ("instances", given, (rows, width)),
            ("starts", first, (rows if len(first) else 0, count, m)),
        ):
            if part.shape != shape:
                raise UserError(f"solve_many: {name} have shape {part.shape}; they need {shape}")
        answers, effort, loop = MpcAnswers.empty(rows, count, n, m), self.effort(attempts), LoopArrays.none()

        def solve(own: HorizonMemory, part: tuple[int, int]) -> None:
            known, weights = own.prediction, own.horizon.weights
            parts = given, begins, first, part, answers, known, weights, loop
            answer_rows(known, own.horizon, own.program, effort, *parts)

        pieces = [(at, min(at + piece, rows)) for at in range(0, rows, piece)]
        list(in_threads(solve, pieces, self.memory, threads))
        return answers

    def follow(self, inputs: Array) -> tuple[float, Array]:
        """Cost of inputs (N, m) for the last call's instance, and the states (N + 1, n) that they lead to, in the exact
        form.
        """
        mpc = self._shooting
        states = np.empty_like(mpc.horizon.states)
        cost, _ = rollout(mpc.prediction, mpc.horizon.weights, self._instance, inputs.copy(), states)
        return float(cost), states

    def _go_on(self, began: float) -> Status:
        """Iterate until solved, out of iterations or out of time."""
        mpc, most, status = self._shooting, self.problem.max_iterations, Status.NOT_CONVERGED
        parts = mpc.prediction, mpc.horizon, mpc.program, self._instance
        while status is Status.NOT_CONVERGED and self.iterations < most:
            if self._clock is not None and self._clock() - began > self._time_limit:
                return Status.LATE
            share = min(BETWEEN_LOOKS, most - self.iterations)
            found = solve_call(*parts, share, self._tolerance, False, False, False)
            self.iterations += found.iterations
            self.residual = found.residual
            status = Status.SOLVED if found.solved else Status.NOT_CONVERGED if found.iterations else Status.FAILED
        return status

    def _rest(self, status: Status) -> MpcSolution:
        """The rest of the last plan, or the previous input."""
        if self._cold:
            return held(self._instance.previous, self.problem, status)
        plan(self._shooting.horizon, self._instance)
        return self._planned(status)

    def _planned(self, status: Status) -> MpcSolution:
        horizon = self._shooting.horizon
        inputs = horizon.planned.copy()
        return MpcSolution(input=inputs[0].copy(), inputs=inputs, states=horizon.states[1:].copy(), status=status)
