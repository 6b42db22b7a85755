"""The cam-driven beam: TecQuipment CE106, a beam turned by a DC motor through a cam follower."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.equations import Law, Motion, Operations, Variable, parameter
from hybrid_sysid_ros.friction import rational_stribeck


@dataclass(frozen=True, kw_only=True)
class CamBeam(Motion):
    """Beam angle q [rad] and rate v [rad/s] under the drive voltage u [V]; every term is per unit inertia.

        e = u(t - delay) - centre;  e <- e (1 + asymmetry sgn e)
        v' = gain e - stiffness q - quadratic_stiffness s^2 - damping (1 + damping_asymmetry sgn v) v - F sat(v / creep)
        F = max(0, [coulomb + stribeck_excess / (1 + (v / stribeck_speed)^2)^2]
                   (1 + friction_slope s + friction_curvature s^2))
        s = q within the range that was identified, so that no term grows outside it.

    The physics: an unbalanced beam (centre, stiffness: tau0 u - K0 (x1 + d0)) on a cam whose lever arm changes with the
    angle (quadratic_stiffness, friction over q) and whose follower is pushed one way and falls the other (asymmetry).
    """

    states = (Variable(name="position", unit="rad"), Variable(name="velocity", unit="rad/s"))
    inputs = (Variable(name="drive", unit="V"),)
    outputs = (0,)
    kinematics: ClassVar[Mapping[int, int]] = {0: 1}
    friction_state = 1

    gain: float = parameter(4.937, 0.1, 40.0, start=4.0, unit="rad/(s^2 V)", description="drive gain")
    centre: float = parameter(
        0.9741, -5.0, 5.0, start=1.0, unit="V", description="input that balances the beam at q = 0"
    )
    stiffness: float = parameter(
        14.22, -50.0, 200.0, start=10.0, unit="1/s^2", description="weak spring of the unbalance"
    )
    damping: float = parameter(31.24, 0.0, 150.0, start=20.0, unit="1/s", description="viscous friction")
    coulomb: float = parameter(2.141, 0.0, 40.0, start=1.5, unit="rad/s^2", description="Coulomb friction level")
    input_delay: float = parameter(0.00754, 0.0, 0.03, start=0.004, unit="s", description="delay of the drive")
    asymmetry: float = parameter(
        0.1252, -0.5, 0.5, start=0.0, spread=0.1, unit="1", description="drive gain up against down"
    )
    quadratic_stiffness: float = parameter(
        -99.28, -3e3, 3e3, start=0.0, spread=200.0, unit="1/(rad s^2)", description="torque that grows with q^2"
    )
    damping_asymmetry: float = parameter(
        0.1063, -0.8, 0.8, start=0.0, spread=0.1, unit="1", description="viscous friction up against down"
    )
    stribeck_excess: float = parameter(
        0.1381, 0.0, 10.0, start=0.2, spread=0.4, unit="rad/s^2", description="friction at rest above the Coulomb level"
    )
    stribeck_speed: float = parameter(
        0.04553, 0.005, 1.0, start=0.05, spread=0.05, unit="rad/s", description="speed at which the excess is gone"
    )
    friction_slope: float = parameter(
        1.859, -20.0, 20.0, start=0.0, spread=3.0, unit="1/rad", description="friction over position, odd part"
    )
    friction_curvature: float = parameter(
        102.2, -600.0, 600.0, start=0.0, spread=100.0, unit="1/rad^2", description="friction over position, even part"
    )
    creep: float = parameter(
        2e-05,
        0.0,
        0.1,
        start=0.002,
        spread=0.005,
        unit="rad/s",
        description="speed below which dry friction is viscous",
    )
    range_low: float = parameter(
        -0.12, -1.0, 1.0, fixed=True, unit="rad", description="lowest position that was identified"
    )
    range_high: float = parameter(
        0.12, -1.0, 1.0, fixed=True, unit="rad", description="highest position that was identified"
    )

    def trained_on(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> CamBeam:
        return dataclasses.replace(self, range_low=float(low[0]), range_high=float(high[0]))

    def law(self, operations: Operations) -> Law:
        friction_level = rational_stribeck(operations)
        minimum, maximum, select = operations.minimum, operations.maximum, operations.select

        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            q, v = x[0], x[1]
            s = minimum(maximum(q, p.range_low), p.range_high)
            e = u[0] - p.centre
            e = e * select(e > 0.0, 1.0 + p.asymmetry, 1.0 - p.asymmetry)
            damping = p.damping * select(v > 0.0, 1.0 + p.damping_asymmetry, 1.0 - p.damping_asymmetry)
            acceleration = p.gain * e - p.stiffness * q - p.quadratic_stiffness * s * s
            shape = 1.0 + p.friction_slope * s + p.friction_curvature * s * s
            level = friction_level(v, p.coulomb, p.stribeck_excess, p.stribeck_speed) * shape
            return (v, acceleration), (maximum(level, 0.0), p.creep, damping)

        return law
