"""Commanding: the kernels of a guard that make of references and inputs what may be sent, over its memory. They are
Python, and are printed as C.
"""

from __future__ import annotations

import math

from hybrid_sysid_ros.control.safety.governor import follow_reference, follow_state
from hybrid_sysid_ros.control.safety.guarding import REMEMBERED, GuardMemory
from hybrid_sysid_ros.support.arrays import Floats


def turn(guard: GuardMemory, inputs: Floats) -> None:
    """Make of what is to act (m,), in place, what has to be sent for that, within its bounds, or the reverse: an input
    that acts reversed, as the estimate or its own report says, has the other sign.
    """
    for j in range(len(guard.inputs)):
        if (guard.core[0].reversed == j) != guard.inputs[j].opposes:
            inputs[j] = min(max(-inputs[j], guard.inputs[j].low), guard.inputs[j].high)


def govern(
    guard: GuardMemory, level: int, now: Floats, found: Floats, preview: Floats, times: Floats, elapsed: float
) -> None:
    """Let a preview (points p,), in place, move as a level allows; now and found (p,): see :mod:`.governor`."""
    governor, outputs = guard.governor[0], guard.outputs
    follow_state(governor, outputs, level > 0, now, found)
    if not governor.free:
        share = 0.0 if level >= 2 else guard.core[0].slow_share if level > 0 else 1.0
        follow_reference(governor, outputs, now, preview, times, share, elapsed, level > 0)


def slow(guard: GuardMemory, inputs: Floats, rest: Floats) -> None:
    """Keep inputs (m,), in place, as near to those at rest (m,) as they must be."""
    for j in range(len(guard.inputs)):
        room = 0.5 * guard.core[0].share * (guard.inputs[j].high - guard.inputs[j].low)
        inputs[j] = min(max(inputs[j], rest[j] - room), rest[j] + room) + guard.inputs[j].trim
    put_on_trial(guard, inputs)


def put_on_trial(guard: GuardMemory, inputs: Floats) -> None:
    """Keep inputs (m,), in place, within their bounds, and as small as they must be where an actuator is on trial."""
    tried = guard.core[0].tried
    for j in range(len(guard.inputs)):
        low, high, middle = guard.inputs[j].low, guard.inputs[j].high, guard.inputs[j].middle
        room = (0.5 * tried if tried < 1.0 else 1.0) * (high - low)
        inputs[j] = min(max(min(max(inputs[j], middle - room), middle + room), low), high)


def make_up(guard: GuardMemory, inputs: Floats) -> None:
    """Let inputs (m,), in place, make up for those that are off their commands: u_i + a_ij (u_j - what j did last)."""
    m = len(guard.inputs)
    for j in range(m):
        for i in range(m):
            if math.isfinite(guard.inputs[j].acts) and not math.isfinite(guard.inputs[i].acts):
                u = inputs[i] + guard.alike[i * m + j] * (inputs[j] - guard.inputs[j].acts)
                inputs[i] = min(max(u, guard.inputs[i].low), guard.inputs[i].high)


def limit_rates(guard: GuardMemory, inputs: Floats, before: Floats, elapsed: float) -> None:
    """Keep inputs (m,), in place, as near to those before (m,) as the actuators can follow in a time [s]."""
    for j in range(len(guard.inputs)):
        if guard.inputs[j].rate < math.inf:
            reach = guard.inputs[j].rate * max(elapsed, 0.0)
            inputs[j] = min(max(inputs[j], before[j] - reach), before[j] + reach)


def remember(guard: GuardMemory, inputs: Floats) -> None:
    """Remember a command (m,) that was sent."""
    core, m = guard.core[0], len(guard.inputs)
    guard.replaced[core.row] = 0.0
    core.row = (core.row + 1) % REMEMBERED
    guard.replaced[core.row] = -math.inf
    for j in range(m):
        guard.sent[core.row * m + j] = inputs[j]
