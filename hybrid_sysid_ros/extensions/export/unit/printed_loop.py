"""The objects of a loop that is printed: Python's own, and what a loop remembers beside them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybrid_sysid_ros.control.mpc.horizon import Horizon, Instance, PredictionModel
from hybrid_sysid_ros.control.mpc.quadratic_program import Program
from hybrid_sysid_ros.support.arrays import Array

PROGRESS = np.dtype(
    [
        *((name, "i8") for name in ("started", "cold", "prepared", "planned", "fresh")),
        *((name, "i8") for name in ("status", "iterations", "resets", "waiting", "unsolved", "reason")),
        *((name, "f8") for name in ("last", "newest", "residual", "age", "unplanned")),
    ]
)
"""What a loop remembers beside its arrays: stamps [s] of the last measurement and of the newest one, the age of a plan
below which a stabiliser acts, the time without a plan, and what a supervisor waits for and found.
"""

WAITING, SOLVED, ITERATED, NOT_CONVERGED, FAILED, POLICY, HELD = range(7)
"""How a command was found; waiting: there is no estimate yet."""


class LoopNumbers(NamedTuple):
    """Numbers of a loop that are known when it is printed."""

    period: float
    """Of the measurements [s]."""
    interval: float
    """Of the controller's horizon [s]."""
    patience: int
    real_time: bool
    tolerance: float
    iterations: int


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


class Supervision(NamedTuple):
    """A supervisor's policy and limits; see :class:`~hybrid_sysid_ros.control.safety.supervisor.Supervisor`."""

    policy: Any
    limits: Any
    """As its check takes them."""
    patience: int
    noise: float
    steps: bool
    near: Array
    """(m,): by how much inputs near each other may differ."""
    flat: Array
    inputs: Array
    """(N, m), the policy's plan."""
    states: Array
    """(N + 1, n)."""
    cost: Array
    """(1,)."""
    kept_inputs: Array
    """(N, m) of the plan before a step."""
    kept_states: Array
    kept_disturbance: Array


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
    prediction: PredictionModel
    horizon: Horizon
    program: Program
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
    supervision: Supervision | None
