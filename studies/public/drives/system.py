"""Coupled electric drives: two motors turn a belt, whose pulley hangs in a spring; a counter shows its speed alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar, absolute, tanh

NEAR = 0.05
"""Speed within which dry friction changes its sign [ticks/s]."""


@dataclass(frozen=True, kw_only=True)
class CoupledDrives(System):
    """m' = (gain u + offset - m - friction tanh(m / s)) / T,  w'' = f^2 (m - w) - 2 d f w',  y' = (|w| - y) / T_y.

    Wigren and Schoukens (2017), Coupled electric drives data set and reference models, Uppsala University, 2017-024.
    """

    states = ("speed [ticks/s]", "motor [ticks/s]", "pulley [ticks/s]", "pulley_rate [ticks/s^2]")
    inputs = ("drive [V]",)
    outputs = ("speed",)
    delays: ClassVar[Mapping[str, str | float]] = {"drive": "delay"}
    stepper = RungeKutta()

    gain: float = bounded(1.0, 0.01, 20.0, unit="ticks/(V s)")
    """Speed per input."""
    offset: float = bounded(0.0, -2.0, 2.0, unit="ticks/s", spread=0.5)
    """Speed without an input."""
    time_constant: float = bounded(0.3, 0.01, 5.0, unit="s")
    """Of the motors."""
    friction: float = bounded(0.0, 0.0, 2.0, unit="ticks/s", spread=0.2)
    """Dry friction of the motors, as the speed that it takes."""
    frequency: float = bounded(12.0, 3.0, 60.0, unit="rad/s")
    """Of the pulley in the belt."""
    damping: float = bounded(0.2, 0.0, 2.0, unit="1")
    """Damping ratio."""
    lag: float = bounded(0.02, 0.004, 0.5, unit="s")
    """Time constant T_y of the counter's filter."""
    delay: float = bounded(0.005, 0.0, 0.06, unit="s")
    """Of the drive."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        y, m, w, rate = x
        wanted = self.gain * u[0] + self.offset - self.friction * tanh(m / NEAR)
        swing = self.frequency * self.frequency * (m - w) - 2.0 * self.damping * self.frequency * rate
        return (absolute(w) - y) / self.lag, (wanted - m) / self.time_constant, rate, swing
