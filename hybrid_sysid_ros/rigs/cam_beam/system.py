"""The cam-driven beam: TecQuipment CE106, a beam turned by a DC motor through a cam follower."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Ageing, Dry, System, bounded
from hybrid_sysid_ros.core.friction import rational_stribeck
from hybrid_sysid_ros.core.mathematics import Scalar, clip, maximum, select, sided, sqrt

SMALLEST_SQUARED_COSINE = 0.1
"""Least squared cosine of the crank's angle, so that the law is finite at a dead centre; no record comes so near."""

DRIVE_CORNER, POSITION_CORNER, SPEED_CORNER = 0.05, 0.002, 0.05
"""Widths over which the corners of the asymmetric drive [V] and of the limits of the identified range [rad, rad/s] are
rounded for solvers that need derivatives.
"""


@dataclass(frozen=True, kw_only=True)
class CamBeam(System):
    """Beam angle q [rad] and rate v [rad/s] under the drive voltage u [V]; every term is per unit inertia.

    The motor turns a crank by phi and the crank the beam, q = A sin phi (cam_curvature = 1 / A^2), so in beam
    angles the drive fades towards the dead centres, and a turning crank pulls the beam back:

        e = u(t - delay) - centre;  e <- e (1 + asymmetry sgn e);  cos phi = sqrt(1 - cam_curvature s^2)
        v' = gain e cos phi - cam_curvature s v^2 / cos^2 phi - stiffness q - quadratic_stiffness s^2
             - damping (1 + damping_asymmetry sgn v) v - F sat(v / creep)
        F = max(0, [coulomb + stribeck_excess / (1 + (v / stribeck_speed)^2)^2]
                   (1 + friction_slope s + friction_curvature s^2))
        s = q, and v in the pull, are limited to the identified range, so that no term grows outside it.

    The physics: an unbalanced beam (centre, stiffness: tau0 u - K0 (x1 + d0)) on a crank whose follower is pushed one
    way and falls the other (asymmetry). The crank is in the records: fitted to all seven, cam_curvature is 52 with a
    standard error of 6 (docs/results/cam-beam.md has the command).
    """

    states = ("position [rad]", "velocity [rad/s]")
    inputs = ("drive [V]",)
    outputs = ("position",)
    contacts = (Dry(on="velocity", level="friction", creep="creep", viscous="viscous"),)
    delays = {"drive": "input_delay"}
    doubtful_terms = ("stribeck", "damping_asymmetry", "creep")

    gain: float = bounded(5.787, 0.1, 40.0, start=4.0, unit="rad/(s^2 V)")
    """Drive gain."""
    centre: float = bounded(0.9394, -5.0, 5.0, start=1.0, unit="V")
    """Input that balances the beam at q = 0."""
    stiffness: float = bounded(12.9, 0.0, 200.0, start=10.0, unit="1/s^2")
    """Weak spring of the unbalance."""
    damping: float = bounded(34.01, 0.0, 150.0, start=20.0, unit="1/s")
    """Viscous friction."""
    coulomb: float = bounded(2.882, 0.0, 40.0, start=1.5, unit="rad/s^2")
    """Coulomb friction level."""
    input_delay: float = bounded(0.008241, 0.0, 0.03, start=0.004, unit="s")
    """Delay of the drive."""
    asymmetry: float = bounded(0.03862, -0.5, 0.5, start=0.0, spread=0.1, unit="1", term="drive_asymmetry")
    """Drive gain up against down."""
    quadratic_stiffness: float = bounded(
        -79.63, -3e3, 3e3, start=0.0, spread=200.0, unit="1/(rad s^2)", term="quadratic_stiffness"
    )
    """Torque that grows with q^2."""
    damping_asymmetry: float = bounded(0.0, -0.8, 0.8, start=0.0, spread=0.1, unit="1", term="damping_asymmetry")
    """Viscous friction up against down."""
    stribeck_excess: float = bounded(0.0, 0.0, 10.0, start=0.2, spread=0.4, unit="rad/s^2", term="stribeck")
    """Friction at rest above the Coulomb level."""
    stribeck_speed: float = bounded(0.05, 0.005, 1.0, start=0.05, spread=0.05, unit="rad/s", term="stribeck")
    """Speed at which the excess vanishes."""
    friction_slope: float = bounded(-0.1432, -20.0, 20.0, start=0.0, spread=3.0, unit="1/rad", term="position_friction")
    """Friction over position, odd part."""
    friction_curvature: float = bounded(
        20.97, -600.0, 600.0, start=0.0, spread=100.0, unit="1/rad^2", term="position_friction"
    )
    """Friction over position, even part."""
    creep: float = bounded(0.0, 0.0, 0.1, start=0.002, spread=0.005, unit="rad/s", term="creep")
    """Speed below which dry friction is viscous."""
    cam_curvature: float = bounded(51.78, 0.0, 120.0, start=0.0, spread=40.0, unit="1/rad^2", term="cam")
    """1 / A^2 of the crank."""
    range_low: float = bounded(-0.1241, -1.0, 1.0, fixed=True, unit="rad")
    """Lowest position that was identified."""
    range_high: float = bounded(0.1123, -1.0, 1.0, fixed=True, unit="rad")
    """Highest position that was identified."""
    range_speed: float = bounded(2.042, 0.0, 100.0, fixed=True, unit="rad/s")
    """Highest speed that was identified."""

    def trained_on(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> CamBeam:
        speed = float(max(abs(low[1]), abs(high[1])))
        return dataclasses.replace(self, range_low=float(low[0]), range_high=float(high[0]), range_speed=speed)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        q, v = x
        s = clip(q, self.range_low, self.range_high, over=POSITION_CORNER)
        speed = clip(v, -self.range_speed, self.range_speed, over=SPEED_CORNER)
        squared_cosine = maximum(1.0 - self.cam_curvature * s * s, SMALLEST_SQUARED_COSINE)
        e = u[0] - self.centre
        e = sided(e, 1.0 + self.asymmetry, 1.0 - self.asymmetry, over=DRIVE_CORNER)
        drive = self.gain * e * sqrt(squared_cosine) - self.cam_curvature * s * speed * speed / squared_cosine
        return v, drive - self.stiffness * q - self.quadratic_stiffness * s * s

    def friction(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Level F of the dry friction [rad/s^2]."""
        q, v = x
        s = clip(q, self.range_low, self.range_high, over=POSITION_CORNER)
        shape = 1.0 + self.friction_slope * s + self.friction_curvature * s * s
        level = rational_stribeck(v, self.coulomb, self.stribeck_excess, self.stribeck_speed)
        return maximum(level * shape, 0.0)

    def viscous(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Viscous rate [1/s], up and down."""
        return self.damping * select(x[1] > 0.0, 1.0 + self.damping_asymmetry, 1.0 - self.damping_asymmetry)


@dataclass(frozen=True, kw_only=True)
class CreepingBeam(CamBeam):
    """The beam with friction that is valid from creeping to full speed: it is at the motor, and ages at rest.

        v' = gain e cos phi - ... - cos phi (coulomb + rest_excess (1 - r)) sat(v / creep)
        r' = |v| (1 - r) / memory - r / rest_time

    The friction is that of motor and gear, before the crank. In beam angles it fades towards the dead centres as the
    drive does, so break-away takes the same input everywhere except for the unbalance. That gives the position friction
    of :class:`CamBeam` without a parameter.
    """

    contacts = (
        Ageing(
            on="velocity",
            level="friction",
            excess="ageing",
            rest_time="rest_time",
            memory="memory",
            creep="creep",
            viscous="viscous",
        ),
    )
    doubtful_terms = ("stribeck", "damping_asymmetry", "position_friction")

    rest_excess: float = bounded(1.5, 0.0, 10.0, start=1.5, spread=1.0, unit="rad/s^2", term="ageing")
    """Friction of the rested contact above that at speed."""
    rest_time: float = bounded(2.0, 0.01, 100.0, start=1.8, spread=1.0, unit="s", term="ageing")
    """Time in which a contact ages."""
    memory: float = bounded(0.01, 1e-4, 1.0, start=0.018, spread=0.01, unit="rad", term="ageing")
    """Sliding displacement that renews the contact."""

    def friction(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        return super().friction(x, u) * self._at_the_motor(x)

    def ageing(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Friction level that the time at rest adds [rad/s^2]."""
        return self.rest_excess * self._at_the_motor(x)

    def _at_the_motor(self, x: Sequence[Scalar]) -> Scalar:
        s = clip(x[0], self.range_low, self.range_high, over=POSITION_CORNER)
        return sqrt(maximum(1.0 - self.cam_curvature * s * s, SMALLEST_SQUARED_COSINE))


SYSTEM = CamBeam()
STRUCTURES = {"creeping": CreepingBeam()}
