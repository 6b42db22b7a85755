"""The objects of a loop that is printed: Python's own, and what a loop remembers beside them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.control.mpc.calls import MpcMemory
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.safety.supervision import SupervisorMemory
from hybrid_sysid_ros.support.arrays import Array

PROGRESS = np.dtype(
    [
        *((name, "i8") for name in ("started", "planned", "fresh", "status", "resets")),
        *((name, "f8") for name in ("last", "newest", "age")),
    ]
)
"""What a loop remembers beside its arrays: how its command was found, stamps [s] of the last measurement and of the
newest one, and the age of a plan below which a stabiliser acts.
"""

WAITING = 0
"""The status while there is no estimate; the others are those of :mod:`~hybrid_sysid_ros.control.mpc.calls`."""


class LoopNumbers(NamedTuple):
    """Numbers of a loop that are known when it is printed."""

    period: float
    """Of the measurements [s]."""
    patience: int


class InitialStates(NamedTuple):
    """Initial states from the first measurement, offset + by_outputs y + by_inputs u, and parts of the belief."""

    offset: Array
    """(n,)."""
    by_outputs: Array
    """(n, p)."""
    by_inputs: Array
    """(n, m)."""
    parameters: Array
    """(followed,): first values."""
    offsets: Array
    """(followed, m): offset of each input per deviation of a followed parameter."""


class PrintedLoop(NamedTuple):
    """The objects of a loop, as Python made them."""

    progress: Any
    """(1,) of :data:`PROGRESS`."""
    settings: LoopNumbers
    initial: InitialStates
    memory: Any
    outputs: Array
    """(p,), of the newest measurement."""
    applied: Array
    """(m,), mean inputs since the one before."""
    out: Array
    P: Array
    mpc: MpcMemory
    instance: Instance
    plan: Array
    """(m,), the controller's own inputs."""
    command: Array
    """(m,), what the rig gets: the same, or with a stabiliser what that makes of them."""
    gains: Array
    """(m, n) of the stabiliser; without rows where there is none."""
    low: Array
    """(m,), lowest commands of a stabiliser."""
    high: Array
    """(m,)."""
    supervisor: SupervisorMemory | None
