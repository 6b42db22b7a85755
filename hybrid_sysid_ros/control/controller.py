"""One interface for every controller."""

from __future__ import annotations

from enum import Enum
from typing import Any, NamedTuple, Protocol

import numpy as np

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


class Status(Enum):
    """How an input was found."""

    SOLVED = "solved"
    """The optimum, to tolerance."""
    ITERATED = "iterated"
    """One real-time iteration towards the optimum."""
    NOT_CONVERGED = "not converged"
    """The solver's last iterate: within the bounds, maybe not optimal."""
    LATE = "late"
    """The time was over: the rest of the last plan."""
    FAILED = "failed"
    """There was no solution: the rest of the last plan."""
    FEEDBACK = "feedback"
    """The input of a fixed law."""
    POLICY = "policy"
    """The network's plan or input."""
    HELD = "held"
    """There was no plan: the last input."""


class MpcSolution(NamedTuple):
    """An answer of a controller, with n states and m inputs; a data class would take as long as a network."""

    input: Array
    """The input to apply now, (m,), within its bounds."""
    inputs: Array
    """Its plan, (horizon, m); controllers without a plan give only the first row."""
    states: Array
    """The predicted states of the plan, (horizon, n), or no row."""
    status: Status


def held(previous: Array, problem: ControlProblem, status: Status) -> MpcSolution:
    """The previous inputs (m,) within their bounds over the whole horizon; 0 or the nearest bound for NaN."""
    last = np.clip(np.where(np.isfinite(previous), previous, 0.0), problem.input_low, problem.input_high)
    return MpcSolution(last, np.tile(last, (problem.horizon, 1)), np.zeros((0, len(problem.state_low))), status)


class Controller(Protocol):
    """The interface of every controller. horizon: number of preview points. period: their distance [s]."""

    @property
    def horizon(self) -> int: ...

    @property
    def period(self) -> float: ...

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """The input for a state.

        state (n,): the state when the input acts, a delay ahead. disturbance (m,): estimated offset of the inputs.
        previous_input (m,): the last applied input. preview (horizon, p): reference of the outputs at period, 2 period,
        ... after the state's time. The input is always finite and within its bounds.
        """
        ...

    def prepare(self, elapsed: float) -> None:
        """Prepare for the next state, ``elapsed`` [s] after this one; call it after the input was sent."""
        ...

    def reset(self) -> None:
        """Forget the past."""
        ...


class OuterController:
    """Base of controllers around another one, which solves the problem."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.horizon, self.period = controller.horizon, controller.period

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.controller!r})"

    @property
    def problem(self) -> ControlProblem:
        """What the controller within solves."""
        problem: ControlProblem = self._within("problem")
        return problem

    def assign(self, **values: Any) -> None:
        """See :meth:`~hybrid_sysid_ros.control.mpc.mpc.ExactMpc.assign`."""
        self._within("assign")(**values)

    def check(self) -> None:
        """See :meth:`~hybrid_sysid_ros.control.mpc.mpc.ExactMpc.check`."""
        self._within("check")()

    def _within(self, name: str) -> Any:
        """An attribute of the controller within. Raises UserError where it has none."""
        if not hasattr(self.controller, name):
            raise UserError(f"mpc: {type(self.controller).__name__} has no {name}; the exact MPC has")
        return getattr(self.controller, name)
