"""Exact model predictive control: sequential quadratic programming in compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Plan, Status
from hybrid_sysid_ros.control.mpc.horizon import Question, finite, respond
from hybrid_sysid_ros.control.mpc.quadratic_program import factorise
from hybrid_sysid_ros.control.mpc.sensitivity import sensitivity
from hybrid_sysid_ros.control.mpc.shooting import Shooting, shooting
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.core import System

Array = NDArray[np.float64]

BETWEEN_LOOKS = 4
"""Iterations between two looks at the clock."""


class ExactMpc:
    """Solves the problem at every call, from the last plan.

    Converged: Gauss-Newton steps until the KKT residual is within the tolerance. In real time: one step a call, whose
    larger part, the linearisation, :meth:`prepare` does beforehand (Diehl et al. 2002, J. Process Control 12(4)).

    Offset-free: d is the estimated input disturbance, so the prediction meets the measurement at rest (Pannocchia &
    Rawlings 2003, AIChE J. 49(2)).
    """

    def __init__(
        self,
        system: System,
        problem: Problem,
        *,
        real_time: bool = False,
        tolerance: float = 1e-6,
        time_limit: float = math.inf,
        clock: Callable[[], float] | None = None,
    ) -> None:
        """tolerance: largest KKT residual of a solution. time_limit: of one call [s], told by ``clock`` (without one
        there is none). Raises UserError for a model that the MPC can't take.
        """
        self.system = system
        self.problem = problem
        self.horizon = problem.horizon
        self.period = problem.period
        self.real_time = real_time
        self._tolerance = tolerance
        self._time_limit = time_limit
        self._clock = clock
        self._shooting = shooting(system, problem)
        states = len(system.states)
        self._question = Question(np.zeros(states), np.zeros(1), np.zeros(1), np.zeros(problem.horizon))
        self._last = (np.zeros((problem.horizon + 1, states)), np.zeros(problem.horizon))
        self.iterations = 0
        self.residual = math.inf
        self.reset()

    def reset(self) -> None:
        """Forget the last plan."""
        self._cold = True
        self._prepared = False

    @property
    def cold(self) -> bool:
        """Whether there is no last plan."""
        return self._cold

    @property
    def shooting(self) -> Shooting:
        """Its memory; the inputs of its horizon are the last plan, as far as :meth:`prepare` moved it on."""
        return self._shooting

    def adopt(self, disturbance: Array, inputs: Array, states: Array) -> None:
        """Take another controller's plan as the last one: inputs (horizon,) and the states (horizon + 1, states) that
        they lead to, under an input disturbance (1,).
        """
        horizon = self._shooting.horizon
        horizon.disturbance[:], horizon.inputs[:], horizon.states[:] = disturbance, inputs, states
        self._cold = self._prepared = False

    def prepare(self, elapsed: float) -> None:
        """Move the plan on by the time until the next call [s], and in real time linearise there."""
        if self._cold:
            return
        mpc = self._shooting
        mpc.shift(mpc.model, mpc.horizon, min(elapsed / self.period, 1.0))
        if self.real_time:
            mpc.prepare(mpc.model, mpc.horizon, mpc.program)
            self._prepared = factorise(mpc.program)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> Plan:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`.

        Where something is not a number, the problem has no solution, or the time is over, the plan is what is left of
        the last one; where there is none, the previous input, or zero if that is no number either.
        """
        question = self._question
        question.state[:] = state
        question.disturbance[:] = disturbance
        question.previous[:] = previous_input
        question.reference[:] = preview
        if not all(map(finite, question)):
            return self._rest(Status.FAILED)
        mpc = self._shooting
        cold = self._cold
        if cold:
            mpc.begin(mpc.model, mpc.horizon, question)
        self._last[0][:] = mpc.horizon.states
        self._last[1][:] = mpc.horizon.inputs
        if self.real_time and self._prepared and not cold:
            self._prepared = False
            status = Status.ITERATED if respond(mpc.horizon, mpc.program, question) else Status.FAILED
        else:
            status = self._solve()
        if status is Status.FAILED or status is Status.LATE or not finite(mpc.horizon.inputs):
            mpc.horizon.states[:], mpc.horizon.inputs[:] = self._last
            return self._rest(status if status is Status.LATE else Status.FAILED)
        self._cold = False
        return self._planned(status)

    def sensitivity(self) -> Array:
        """Derivatives of the first input by [x, d, u_previous, q_1..q_N], (states + 2 + horizon,), at the answer that
        :meth:`control` just gave with SOLVED; NaN where it has none. See :mod:`~.sensitivity`.
        """
        return sensitivity(self._shooting, self._question)[0]

    def _solve(self) -> Status:
        """Iterate until solved, out of iterations or out of time."""
        mpc, most = self._shooting, self.problem.max_iterations
        began = self._clock() if self._clock is not None else 0.0
        self.iterations = 0
        while True:
            share = most - self.iterations if self._clock is None else min(BETWEEN_LOOKS, most - self.iterations)
            anew = self.iterations == 0
            answer = mpc.solve(mpc.model, mpc.horizon, mpc.program, self._question, share, self._tolerance, anew)
            self.iterations += answer.iterations
            self.residual = answer.residual
            if answer.iterations == 0:
                return Status.FAILED
            if answer.solved:
                return Status.SOLVED
            if self.iterations >= most:
                return Status.NOT_CONVERGED
            if self._clock is not None and self._clock() - began > self._time_limit:
                return Status.LATE

    def _rest(self, status: Status) -> Plan:
        """What is left of the last plan, or the previous input."""
        if not self._cold:
            return self._planned(status)
        last, limit = float(self._question.previous[0]), self.problem.input_limit
        held = min(max(last, -limit), limit) if math.isfinite(last) else 0.0
        inputs = np.full((self.horizon, 1), held)
        nowhere = np.zeros((0, len(self.system.states)))
        return Plan(input=inputs[0].copy(), inputs=inputs, states=nowhere, status=status)

    def _planned(self, status: Status) -> Plan:
        horizon, limit = self._shooting.horizon, self.problem.input_limit
        inputs = np.minimum(np.maximum(horizon.inputs, -limit), limit)[:, None]
        return Plan(input=inputs[0].copy(), inputs=inputs, states=horizon.states[1:].copy(), status=status)
