"""The cam-driven beam: TecQuipment CE106, a beam turned by a DC motor through a cam follower."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Law, Motion, Operations, Variable, parameter
from hybrid_sysid_ros.core.friction import rational_stribeck

SMALLEST_SQUARED_COSINE = 0.1
"""Of the crank's angle: no record comes that near to a dead centre, and beyond it the law must stay finite."""


@dataclass(frozen=True, kw_only=True)
class CamBeam(Motion):
    """Beam angle q [rad] and rate v [rad/s] under the drive voltage u [V]; every term is per unit inertia.

    The motor turns a crank by phi and the crank the beam, q = A sin phi (cam_curvature = 1 / A^2), so in beam
    angles the drive fades towards the dead centres, and a turning crank pulls the beam back:

        e = u(t - delay) - centre;  e <- e (1 + asymmetry sgn e);  cos phi = sqrt(1 - cam_curvature s^2)
        v' = gain e cos phi - cam_curvature s v^2 / cos^2 phi - stiffness q - quadratic_stiffness s^2
             - damping (1 + damping_asymmetry sgn v) v - F sat(v / creep)
        F = max(0, [coulomb + stribeck_excess / (1 + (v / stribeck_speed)^2)^2]
                   (1 + friction_slope s + friction_curvature s^2))
        s = q and v in the pull within the range that was identified, so that no term grows outside it.

    The physics: an unbalanced beam (centre, stiffness: tau0 u - K0 (x1 + d0)) on a crank whose follower is pushed one
    way and falls the other (asymmetry). The crank is in the records: fitted to all seven, cam_curvature is 49 with a
    standard error of 6 (the README's command for the simulated beam).
    """

    states = (Variable(name="position", unit="rad"), Variable(name="velocity", unit="rad/s"))
    inputs = (Variable(name="drive", unit="V"),)
    outputs = (0,)
    kinematics: ClassVar[Mapping[int, int]] = {0: 1}
    friction_state = 1
    doubtful_terms = ("stribeck", "damping_asymmetry", "creep")

    gain: float = parameter(4.627, 0.1, 40.0, start=4.0, unit="rad/(s^2 V)", description="drive gain")
    centre: float = parameter(
        0.9393, -5.0, 5.0, start=1.0, unit="V", description="input that balances the beam at q = 0"
    )
    stiffness: float = parameter(
        10.69, 0.0, 200.0, start=10.0, unit="1/s^2", description="weak spring of the unbalance"
    )
    damping: float = parameter(26.86, 0.0, 150.0, start=20.0, unit="1/s", description="viscous friction")
    coulomb: float = parameter(2.297, 0.0, 40.0, start=1.5, unit="rad/s^2", description="Coulomb friction level")
    input_delay: float = parameter(0.003326, 0.0, 0.03, start=0.004, unit="s", description="delay of the drive")
    asymmetry: float = parameter(
        0.03917,
        -0.5,
        0.5,
        start=0.0,
        spread=0.1,
        unit="1",
        term="drive_asymmetry",
        description="drive gain up against down",
    )
    quadratic_stiffness: float = parameter(
        -62.68,
        -3e3,
        3e3,
        start=0.0,
        spread=200.0,
        unit="1/(rad s^2)",
        term="quadratic_stiffness",
        description="torque that grows with q^2",
    )
    damping_asymmetry: float = parameter(
        0.0,
        -0.8,
        0.8,
        start=0.0,
        spread=0.1,
        unit="1",
        term="damping_asymmetry",
        description="viscous friction up against down",
    )
    stribeck_excess: float = parameter(
        0.0,
        0.0,
        10.0,
        start=0.2,
        spread=0.4,
        unit="rad/s^2",
        term="stribeck",
        description="friction at rest above the Coulomb level",
    )
    stribeck_speed: float = parameter(
        0.05,
        0.005,
        1.0,
        start=0.05,
        spread=0.05,
        unit="rad/s",
        term="stribeck",
        description="speed at which the excess is gone",
    )
    friction_slope: float = parameter(
        0.05573,
        -20.0,
        20.0,
        start=0.0,
        spread=3.0,
        unit="1/rad",
        term="position_friction",
        description="friction over position, odd part",
    )
    friction_curvature: float = parameter(
        26.89,
        -600.0,
        600.0,
        start=0.0,
        spread=100.0,
        unit="1/rad^2",
        term="position_friction",
        description="friction over position, even part",
    )
    creep: float = parameter(
        0.0,
        0.0,
        0.1,
        start=0.002,
        spread=0.005,
        unit="rad/s",
        term="creep",
        description="speed below which dry friction is viscous",
    )
    cam_curvature: float = parameter(
        48.84, 0.0, 120.0, start=0.0, spread=40.0, unit="1/rad^2", term="cam", description="1 / A^2 of the crank"
    )
    range_low: float = parameter(
        -0.1241, -1.0, 1.0, fixed=True, unit="rad", description="lowest position that was identified"
    )
    range_high: float = parameter(
        0.1123, -1.0, 1.0, fixed=True, unit="rad", description="highest position that was identified"
    )
    range_speed: float = parameter(
        2.042, 0.0, 100.0, fixed=True, unit="rad/s", description="highest speed that was identified"
    )

    def trained_on(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> CamBeam:
        speed = float(max(abs(low[1]), abs(high[1])))
        return dataclasses.replace(self, range_low=float(low[0]), range_high=float(high[0]), range_speed=speed)

    def law(self, operations: Operations) -> Law:
        friction_level = rational_stribeck(operations)
        minimum, maximum, select = operations.minimum, operations.maximum, operations.select
        sqrt = operations.sqrt

        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            q, v = x[0], x[1]
            s = minimum(maximum(q, p.range_low), p.range_high)
            speed = minimum(maximum(v, -p.range_speed), p.range_speed)
            squared_cosine = maximum(1.0 - p.cam_curvature * s * s, SMALLEST_SQUARED_COSINE)
            e = u[0] - p.centre
            e = e * select(e > 0.0, 1.0 + p.asymmetry, 1.0 - p.asymmetry)
            drive = p.gain * e * sqrt(squared_cosine) - p.cam_curvature * s * speed * speed / squared_cosine
            acceleration = drive - p.stiffness * q - p.quadratic_stiffness * s * s
            damping = p.damping * select(v > 0.0, 1.0 + p.damping_asymmetry, 1.0 - p.damping_asymmetry)
            shape = 1.0 + p.friction_slope * s + p.friction_curvature * s * s
            level = friction_level(v, p.coulomb, p.stribeck_excess, p.stribeck_speed) * shape
            return (v, acceleration), (maximum(level, 0.0), p.creep, damping)

        return law
