"""Cascaded tanks: a pump fills the upper tank, which empties into the lower one; both may overflow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar, maximum, sqrt

FULL = 10.0
"""Reading of a full tank [V]."""
SPILL = 2.0
"""Rate at which what is above the brim leaves a tank [1/s]."""
LEAST = 1e-6
"""Level below which an outflow stays finite in its slope [V]."""


@dataclass(frozen=True, kw_only=True)
class CascadedTanks(System):
    """a' = k4 u - k1 sqrt(a) - l1 a - spill(a),  b' = k2 sqrt(a) + l2 a - k3 sqrt(b) - l3 b + k5 spill(a) - spill(b).

    Schoukens, Mattson, Wigren and Noel (2016), Cascaded tanks benchmark combining soft and hard nonlinearities; outflow
    as a root of the level (Bernoulli) and, through a long pipe, partly as the level itself; of what the upper tank
    spills, the share k5 falls into the lower one.
    """

    states = ("upper [V]", "level [V]")
    inputs = ("pump [V]",)
    outputs = ("level",)
    stepper = RungeKutta()

    inflow: float = bounded(0.05, 0.0, 1.0, unit="1/s")
    """Of the pump."""
    drain: float = bounded(0.05, 0.0, 1.0, unit="V^.5/s")
    """Of the upper tank, by the root of its level."""
    loss: float = bounded(0.0, -0.05, 0.1, unit="1/s", spread=0.01)
    """Of the upper tank, by its level."""
    feed: float = bounded(0.05, 0.0, 1.0, unit="V^.5/s")
    """Of the lower tank, by the root of the upper level."""
    seep: float = bounded(0.0, -0.05, 0.1, unit="1/s", spread=0.01)
    """Of the lower tank, by the upper level."""
    outflow: float = bounded(0.05, 0.0, 1.0, unit="V^.5/s")
    """Of the lower tank, by the root of its level."""
    leak: float = bounded(0.0, -0.05, 0.1, unit="1/s", spread=0.01)
    """Of the lower tank, by its level."""
    caught: float = bounded(0.5, 0.0, 2.0, unit="1", spread=0.5)
    """Share of the spilt water that the lower tank catches."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        a, b = (maximum(value, LEAST) for value in x)
        spilt = SPILL * maximum(x[0] - FULL, 0.0)
        upper = self.inflow * u[0] - self.drain * sqrt(a) - self.loss * a - spilt
        gained = self.feed * sqrt(a) + self.seep * a + self.caught * spilt
        return upper, gained - self.outflow * sqrt(b) - self.leak * b - SPILL * maximum(x[1] - FULL, 0.0)
