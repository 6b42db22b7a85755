"""A problem with the instance that is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.control import ControlProblem
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.arrays import Array, Numbers


@dataclass(frozen=True, kw_only=True)
class Case:
    """A system, its problem, and the state from which it is solved without a disturbance."""

    source: str
    """Where the problem, or what it is modelled on, is found."""
    system: System
    problem: ControlProblem
    state: Numbers
    """(n,)."""
    target: Numbers = (0.0,)
    """Reference of the outputs over the whole horizon, (p,)."""
    previous: Numbers = (0.0,)
    """Inputs before the first interval, (m,)."""
    drawn: tuple[str, str] = ("", "")
    """Variables of the picture's axes, to the right and up; "" to the right: time."""

    @property
    def instance(self) -> tuple[Array, Array, Array, Array]:
        """State, disturbance, previous inputs and preview."""
        m, p = len(self.system.inputs), len(self.system.outputs)
        preview = np.tile(np.broadcast_to(self.target, (p,)), (self.problem.horizon, 1))
        return np.array(self.state), np.zeros(m), np.broadcast_to(self.previous, (m,)).copy(), preview
