"""One interface for every controller."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.support.arrays import Array


class Status(Enum):
    """What stands behind an input."""

    SOLVED = "solved"
    """The optimum, to tolerance."""
    ITERATED = "iterated"
    """One real-time iteration towards the optimum."""
    NOT_CONVERGED = "not converged"
    """The solver's last iterate: within the bounds, maybe not optimal."""
    LATE = "late"
    """Out of time: the rest of the last plan."""
    FAILED = "failed"
    """No solution: the rest of the last plan."""
    FEEDBACK = "feedback"
    """The input of a fixed law."""
    POLICY = "policy"
    """The network's plan."""
    HELD = "held"
    """Nothing to go on: the last input."""


class MpcSolution(NamedTuple):
    """A tuple, for a data class takes as long to make as a network to answer. n states, m inputs."""

    input: Array
    """(m,), what to apply now, within its bounds."""
    inputs: Array
    """(horizon, m), the plan behind it, where the controller has one; else only the first row."""
    states: Array
    """(horizon, n), where it leads; else no row."""
    status: Status


def held(previous: Array, problem: ControlProblem, status: Status) -> MpcSolution:
    """The previous inputs (m,) within their bounds over the whole horizon, 0 or the nearest for what is no number."""
    last = np.clip(np.where(np.isfinite(previous), previous, 0.0), problem.input_low, problem.input_high)
    return MpcSolution(last, np.tile(last, (problem.horizon, 1)), np.zeros((0, len(problem.state_low))), status)


class Controller(Protocol):
    """horizon: number of preview points. period: their distance [s]."""

    @property
    def horizon(self) -> int: ...

    @property
    def period(self) -> float: ...

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """The input for a state.

        state (n,): the one that the input will meet, a delay ahead. disturbance (m,): estimated offset of the inputs.
        previous_input (m,): the one applied last. preview (horizon, p): reference of the outputs, at period,
        2 period, ... after the state's time. The input of the plan is within the bounds and finite, always.
        """
        ...

    def prepare(self, elapsed: float) -> None:
        """What can be done before the next state is known, ``elapsed`` [s] after this one; call it after the input is
        out.
        """
        ...

    def reset(self) -> None:
        """Forget the past."""
        ...
