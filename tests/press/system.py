"""A hydraulic press for tests: two inputs, two outputs, and a pressure that no sensor shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import Dry, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class Press(System):
    """v' = area P - load - spring q - drag v - friction sgn v,  P' = gain valve - leak P - coupling v.

    The flow through the leak is measured, which is no state.
    """

    states = ("position [m]", "speed [m/s]", "pressure [bar]")
    inputs = ("valve [V]", "load [m/s^2]")
    outputs = ("position", "leakage [bar/s]")
    contacts = (Dry(on="speed", level="friction", viscous="drag"),)
    delays = {"valve": "valve_delay"}

    area: float = bounded(3.0, 0.1, 30.0, start=2.0, unit="m/(s^2 bar)")
    """Of the piston, per mass."""
    spring: float = bounded(40.0, 0.0, 400.0, start=30.0, unit="1/s^2")
    """Return spring."""
    drag: float = bounded(6.0, 0.0, 60.0, start=4.0, unit="1/s")
    """Viscous friction."""
    friction: float = bounded(0.4, 0.0, 10.0, start=0.2, unit="m/s^2")
    """Dry friction."""
    gain: float = bounded(5.0, 0.1, 50.0, start=3.0, unit="bar/(s V)")
    """Of the valve."""
    leak: float = bounded(2.0, 0.01, 20.0, start=1.5, unit="1/s")
    """Of the cylinder."""
    coupling: float = bounded(8.0, 0.0, 80.0, start=5.0, unit="bar/m")
    """Pressure that motion takes away."""
    valve_delay: float = bounded(0.012, 0.0, 0.05, start=0.004, unit="s")
    """Of the valve."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        q, v, pressure = x
        valve, load = u
        push = self.area * pressure - load - self.spring * q
        return v, push, self.gain * valve - self.leak * pressure - self.coupling * v

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[0], self.leak * x[2]
