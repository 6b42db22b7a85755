"""The lecture's model with Stribeck friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from hybrid_sysid_ros.equations import Law, Motion, Operations, Variable, parameter
from hybrid_sysid_ros.friction import stribeck


@dataclass(frozen=True, kw_only=True)
class Stribeck(Motion):
    """v' = gain (u - centre) - stiffness q - damping v - [Fc + (Fs - Fc) exp(-(v / vs)^2)] sgn v, per unit inertia.

    The printed law of the lecture lost sgn(v); this is the corrected one. Fs = coulomb + static_excess.
    """

    states = (Variable(name="position", unit="rad"), Variable(name="velocity", unit="rad/s"))
    inputs = (Variable(name="drive", unit="V"),)
    kinematics: ClassVar[Mapping[int, int]] = {0: 1}
    friction_state = 1

    gain: float = parameter(4.0, 0.01, 400.0, unit="rad/(s^2 V)", description="drive gain")
    centre: float = parameter(0.0, -5.0, 5.0, unit="V", description="input that balances the joint at q = 0")
    stiffness: float = parameter(10.0, -50.0, 500.0, unit="1/s^2", description="spring")
    damping: float = parameter(20.0, 0.0, 150.0, unit="1/s", description="viscous friction")
    input_delay: float = parameter(0.004, 0.0, 0.03, unit="s", description="delay of the drive")
    coulomb: float = parameter(1.0, 0.0, 100.0, unit="rad/s^2", description="friction level at speed")
    static_excess: float = parameter(
        0.2, 0.0, 100.0, spread=0.5, unit="rad/s^2", description="friction at rest above that level"
    )
    stribeck_speed: float = parameter(
        0.05, 0.005, 2.0, spread=0.05, unit="rad/s", description="speed at which the excess is gone"
    )

    def law(self, operations: Operations) -> Law:
        friction_level = stribeck(operations)

        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            q, v = x[0], x[1]
            acceleration = p.gain * (u[0] - p.centre) - p.stiffness * q
            level = friction_level(v, p.coulomb, p.coulomb + p.static_excess, p.stribeck_speed)
            return (v, acceleration), (level, 0.0, p.damping)

        return law
