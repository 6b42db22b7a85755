"""Friction curve: a model's friction over speed, in units of the input that balances it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import one_step
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

INSTANT = 1e-6  # s, over which an acceleration is computed
SECANTS = 20
SLOWEST = 0.02
"""Lowest speed, as a share of the highest one in the training data."""
SPEEDS = 50


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionCurve:
    """Friction over speed at the origin, as an input: half the difference of the inputs that keep a speed and its
    opposite. Records determine this best, since gain and friction level are correlated.
    """

    speeds: Array
    """(speeds,) [unit of the velocity]."""
    inputs: Array
    """(speeds,) [unit of the input]."""

    def difference(self, other: FrictionCurve) -> float:
        """Relative rms difference from another curve at the same speeds."""
        return float(np.sqrt(np.mean((self.inputs / other.inputs - 1.0) ** 2)))


def speeds_of(model: Model) -> Array:
    """Speeds (speeds,) up to the highest one in a model's training data. Raises UserError as velocity_of() does."""
    system = model.system
    low, high = model.training_range[system.states[velocity_of(system)].name]
    return np.asarray(max(-low, high) * np.linspace(SLOWEST, 1.0, SPEEDS))


def friction_curve(system: System, speeds: Array) -> FrictionCurve:
    """The curve of a system at speeds (speeds,). Raises UserError as velocity_of() does."""
    velocity = velocity_of(system)
    found = [0.5 * (_input(system, velocity, speed) - _input(system, velocity, -speed)) for speed in speeds.tolist()]
    return FrictionCurve(speeds=speeds, inputs=np.array(found))


def velocity_of(system: System) -> int:
    """The velocity with friction. Raises UserError where there is none or more than one, where there are several
    inputs, and where friction has a memory.
    """
    names = [item.name for item in system.states]
    rubbing = {contact.on for contact in system.contacts}
    moving = set(system.kinematics.values())
    if len(rubbing) != 1 or len(moving) > 1 or len(system.inputs) != 1 or len(names) > len(system.declared_states):
        raise UserError(
            f"{type(system).__name__}: a friction curve needs one velocity, friction without memory, and one input"
        )
    return names.index(rubbing.pop())


def _input(system: System, velocity: int, speed: float) -> float:
    """The input that keeps a speed, by the secant method."""
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
