"""The objects of a loop that is printed: Python's own, and what a loop remembers beside them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.control.mpc.calls import MpcMemory
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.safety.guarding import GuardMemory
from hybrid_sysid_ros.control.safety.supervision import SupervisorMemory
from hybrid_sysid_ros.control.waiting_inputs import InputsOnTheirWay
from hybrid_sysid_ros.extensions.export.unit.records import SensorWatch
from hybrid_sysid_ros.support.arrays import Array

PROGRESS = np.dtype(
    [
        *((name, "i8") for name in ("planned", "fresh", "status", "resets", "returning", "noted")),
        *((name, "f8") for name in ("age", "answered", "elapsed", "stale", "lost", "doubt", "without", "reversed")),
    ]
)
"""What a loop remembers beside its arrays: how its command was found, and the age [s] of a plan below which a
stabiliser acts. answered, elapsed: stamp of the newest measurement that was, and the time since the one before [s].
stale, lost: for how long no newer measurement has come, and no sound answer was found [s].
returning: whether the loop comes back from rest. noted: whether the guard has taken in the command. doubt, without,
reversed: of the estimate.
"""
STAMPS = np.dtype([("started", "i8"), ("last", "f8"), ("newest", "f8")])
"""Of an estimate: whether it has begun, stamps [s] of its last measurement and of the newest one."""
FILTER = ("stamps", "core", "moments", "readings", "past", "belief_means", "belief_roots", "belief_applied")
"""Arrays that an estimate remembers from one measurement to the next; each further estimate has its own."""

WAITING, RESTED = 0, 7
"""The status while there is no estimate, and while the guard rests the inputs; the others are those of
:mod:`~hybrid_sysid_ros.control.mpc.calls`.
"""


class LoopNumbers(NamedTuple):
    """Numbers of a loop that are known when it is printed."""

    period: float
    """Of the measurements [s]."""
    patience: int
    stale_after: float
    """Without a newer measurement for this time the last command is held [s]."""
    zero_after: float
    """Without a sound answer for this time the inputs rest [s]."""


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
    stamps: Any
    """(1,) of :data:`STAMPS`."""
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
    on_way: InputsOnTheirWay | None
    """Where inputs have different delays."""
    supervisor: SupervisorMemory | None
    guard: GuardMemory
    monitor: SensorWatch
    at_rest: Array
    """(m,), inputs at rest."""
    reach_low: Array
    """(p,), lowest references."""
    reach_high: Array
    """(p,)."""
    now: Array
    """(p,), the reference when the next command acts."""
    times: Array
    """(N,), of the preview, from then on [s]."""
    preview: Array
    """(N p,), of the instance."""
