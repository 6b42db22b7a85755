"""The lecture's model with Stribeck friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core import Law, Operations, parameter
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.models.linear import Linear


@dataclass(frozen=True, kw_only=True)
class Stribeck(Linear):
    """v' = gain (u - centre) - stiffness q - damping v - [Fc + (Fs - Fc) exp(-(v / vs)^2)] sgn v, per unit inertia.

    The printed law of the lecture lost sgn(v); this is the corrected one. Fs = coulomb + static_excess.
    """

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
            level = friction_level(x[1], p.coulomb, p.coulomb + p.static_excess, p.stribeck_speed)
            return (x[1], p.gain * (u[0] - p.centre) - p.stiffness * x[0]), (level, 0.0, p.damping)

        return law
