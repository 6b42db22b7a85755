"""What a rig's file says of parameters that it does not write: ranges of each entry, and defaults that follow it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hybrid_sysid_ros.rigs.rig import BEYOND, Rig

TOLERANCE = 1e-9
"""Relative, of times that are sums."""


def needed_preview(
    rig: Rig, controller: Mapping[str, Any], reference: Mapping[str, Any], horizon: float = 0.0
) -> float:
    """Time that a reference must cover [s]. horizon: of the controller in use [s]; 0: by its parameters."""
    ahead = horizon or controller["horizon"] * controller["period"]
    return float(ahead + controller["latency"] + rig.system.delay + reference["publish_period"])


def rounded_up(seconds: float) -> float:
    """To hundredths."""
    return math.ceil(100.0 * seconds * (1.0 - TOLERANCE)) / 100.0


def _rate(rig: Rig, default: float) -> float:
    """The nearest rate whose period is a whole number of the rig's steps, and at least 1 Hz."""
    count = max(round(1.0 / (default * rig.step)), 1)
    return default if abs(count * rig.step * default - 1.0) < TOLERANCE else max(1.0 / (count * rig.step), 1.0)


def _of_actuators(rig: Rig) -> list[list[float]]:
    """As far as each input reaches, with either sign."""
    largest = [max(abs(item.low), abs(item.high)) for item in rig.actuators]
    return [[-value, value] for value in largest]


def _of_outputs(rig: Rig) -> list[list[float]]:
    """As far as each output travels, as it is shown, with either sign; BEYOND where no stop is known."""
    low, high = np.abs(rig.travel_of_outputs) / np.abs([display.scale for display in rig.display])
    return [[-value, value] for value in np.minimum(np.maximum(low, high), BEYOND).tolist()]


def _of_velocities(rig: Rig) -> list[list[float]]:
    """Of each state, 0 for one that a joint has as the position to a velocity: a brake can't hold it by itself."""
    positions = {item.position for item in rig.joints.joints.values() if item.velocity}
    return [[0.0, 0.0 if item.name in positions else BEYOND] for item in rig.system.states]


RANGES: Mapping[str, Callable[[Rig], list[list[float]]]] = {
    "ACTUATOR": _of_actuators,
    "SPAN": lambda rig: [[0.0, item.high - item.low] for item in rig.actuators],
    "TRAVEL": _of_outputs,
    "VELOCITY": _of_velocities,
}
"""Ranges of each entry."""

FOLLOWS: Mapping[str, Callable[[Rig, float, Mapping[str, Any], Mapping[str, Any]], float]] = {
    "STEP": lambda rig, default, _, __: _rate(rig, default),
    "HORIZON": lambda rig, default, own, controller: max(default, rounded_up(needed_preview(rig, controller, own))),
}
"""Defaults by the rig, the declared one, the node's other values and those of the controller."""
