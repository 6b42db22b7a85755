"""Limits: what a rig's file says of its travel, validity and actuators, for the controllers that keep to it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hybrid_sysid_ros.rigs.rig import MARGIN, Rig
from hybrid_sysid_ros.support.arrays import Array

FREE = (-math.inf, math.inf)
PRICE = 100.0
"""Of being outside of the rig's travel or validity, relative to that of an error of tracking of the same size."""

Bounds = Mapping[str, tuple[float, float]]
"""Lowest and highest value by state."""


def state_bounds(rig: Rig) -> Bounds:
    """Those of the states that the rig's travel or validity bounds."""
    low, high = rig.travel
    if rig.validity is not None:
        low, high = np.maximum(low, rig.validity[0]), np.minimum(high, rig.validity[1])
    names = [item.name for item in rig.system.states]
    found = zip(names, zip(low.tolist(), high.tolist(), strict=True), strict=True)
    return {name: ends for name, ends in found if ends != FREE}


def stops_of(rig: Rig) -> frozenset[str]:
    """States at whose stops a rig that can't rest has fallen, beyond what its stabiliser can lift."""
    if rig.experiments.stabiliser is None:
        return frozenset()
    return frozenset(
        item.name for item, ends in zip(rig.system.states, rig.travel.T, strict=True) if np.isfinite(ends).all()
    )


def reading_ranges(rig: Rig) -> list[tuple[float, float, bool]]:
    """Lowest and highest reading of each output [SI] that is no stop, or not clearly outside of the rig's range; and
    whether that is a stop.
    """
    bounds, stops, found = state_bounds(rig), stops_of(rig), []
    for item in rig.system.outputs:
        low, high = bounds.get(item.name, FREE)
        room = MARGIN * (high - low) if math.isfinite(high - low) else 0.0
        inside = room if item.name in stops else -room
        found.append((low + inside, high - inside, item.name in stops))
    return found


def least_prices(weights: Sequence[float], rig: Rig, bounds: Bounds) -> dict[str, float]:
    """Least price of the square by which a bounded state is outside, by state: PRICE times that of its tracking.

    weights: of squared errors, (outputs,) [1/shown unit^2]; a state that is no output has no least price.
    """
    outputs = zip(rig.system.outputs, rig.display, weights, strict=True)
    return {item.name: PRICE * weight / display.scale**2 for item, display, weight in outputs if item.name in bounds}


def input_rates(own: Sequence[float], rig: Rig | None = None) -> Array:
    """Fastest changes (inputs,) [input unit/s]: those of the rig's actuators, or slower ones of its own, where 0 is
    none. Without a rig its own alone.
    """
    given = np.array([rate or math.inf for rate in own])
    return given if rig is None else np.minimum(given, [actuator.rate for actuator in rig.actuators])
