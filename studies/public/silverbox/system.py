"""The Silverbox: an electronic circuit that moves as a mass on a hardening spring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import Scalar


@dataclass(frozen=True, kw_only=True)
class Silverbox(System):
    """x'' = w^2 (gain u + offset - x - square x^2 - cube x^3) - 2 d w x', measured behind electronics of their own.

    Wigren and Schoukens (2013), Three free data sets for development and benchmarking in nonlinear system
    identification, ECC. lead and direct are the first terms of what amplifiers and filters do to amplitude and phase.
    """

    states = ("displacement [V]", "rate [V/s]")
    inputs = ("force [V]",)
    outputs = ("voltage [V]",)
    stepper = RungeKutta()

    frequency: float = bounded(430.0, 100.0, 1000.0, unit="rad/s")
    """Natural frequency w."""
    damping: float = bounded(0.05, 0.0, 1.0, unit="1")
    """Damping ratio d."""
    gain: float = bounded(0.9, 0.01, 10.0, unit="1")
    """Displacement per input at rest."""
    offset: float = bounded(0.0, -0.1, 0.1, unit="V")
    """Input of the circuit without a signal."""
    square: float = bounded(0.0, -10.0, 10.0, unit="1/V", spread=1.0)
    """Asymmetry of the spring."""
    cube: float = bounded(3.0, -100.0, 100.0, unit="1/V^2", spread=3.0)
    """Hardening of the spring."""
    lead: float = bounded(0.0, -100.0, 100.0, unit="1/s", spread=10.0)
    """Of the input past the inertia."""
    direct: float = bounded(0.0, -0.5, 0.5, unit="1", spread=0.05)
    """Of the input to the output at once."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        q, v = x
        w = self.frequency
        spring = q + self.square * q * q + self.cube * q * q * q
        push = self.gain * u[0] + self.offset - spring
        return v + self.lead * u[0], w * w * push - 2.0 * self.damping * w * v

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return (x[0] + self.direct * u[0],)
