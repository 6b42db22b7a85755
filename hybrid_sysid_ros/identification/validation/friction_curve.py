"""Friction curve: what friction a model has over speed, told by the input that it takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import one_step
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

INSTANT = 1e-6  # s, over which an acceleration is looked at
SECANTS = 20
SLOWEST = 0.02
"""Of the highest speed that was learned from."""
SPEEDS = 50


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionCurve:
    """Friction over speed at the origin, as the input that it takes: half of what lies between the inputs that keep a
    speed and its opposite. In this measure it is what records tell best: gain and level lie in one valley.
    """

    speeds: Array
    """(speeds,) [unit of the velocity]."""
    inputs: Array
    """(speeds,) [unit of the input]."""

    def difference(self, other: FrictionCurve) -> float:
        """From another curve at the same speeds, rms, relative to that."""
        return float(np.sqrt(np.mean((self.inputs / other.inputs - 1.0) ** 2)))


def speeds_of(model: Model) -> Array:
    """Speeds (speeds,) up to the highest one that a model has learned from. Raises UserError: see velocity_of()."""
    system = model.system
    low, high = model.training_range[system.states[velocity_of(system)].name]
    return np.asarray(max(-low, high) * np.linspace(SLOWEST, 1.0, SPEEDS))


def friction_curve(system: System, speeds: Array) -> FrictionCurve:
    """The curve of a system at speeds (speeds,). Raises UserError where it has none: see velocity_of()."""
    velocity = velocity_of(system)
    found = [0.5 * (_input(system, velocity, speed) - _input(system, velocity, -speed)) for speed in speeds.tolist()]
    return FrictionCurve(speeds=speeds, inputs=np.array(found))


def velocity_of(system: System) -> int:
    """The state that rubs. Raises UserError where it is none, or not the only velocity, there are several inputs, or
    friction has a memory.
    """
    names = [item.name for item in system.states]
    rubbing = {contact.on for contact in system.contacts}
    moving = set(system.kinematics.values())
    if len(rubbing) != 1 or len(moving) > 1 or len(system.inputs) != 1 or len(names) > len(system.declared_states):
        raise UserError(
            f"{type(system).__name__}: a friction curve needs one velocity that rubs, without a memory, and one input"
        )
    return names.index(rubbing.pop())


def _input(system: System, velocity: int, speed: float) -> float:
    """The input under which a speed stays, by secants."""
    state = np.zeros(len(system.states))
    state[velocity] = speed

    def acceleration(value: float) -> float:
        following = one_step(system, state, np.array([value]), step=INSTANT)
        return float(following[velocity] - speed) / INSTANT

    before, here = 0.0, float(np.copysign(1.0, speed))
    slow, now = acceleration(before), acceleration(here)
    for _ in range(SECANTS):
        if now == slow or abs(now) < 1e-6:
            break
        before, here, slow = here, here - now * (here - before) / (now - slow), now
        now = acceleration(here)
    return here
