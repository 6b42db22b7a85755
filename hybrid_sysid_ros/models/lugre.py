"""A one-joint rig with LuGre friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core import Law, Operations, Variable, parameter
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.models.stribeck import Stribeck


@dataclass(frozen=True, kw_only=True)
class LuGre(Stribeck):
    """v' = gain (u - centre) - stiffness q - damping v - s0 z - s1 z',  z' = v - |v| s0 z / F(v), per unit inertia,
    F(v) = Fc + (Fs - Fc) exp(-(v / vs)^2).

    z: deflection of the bristles, hidden; s0 = bristle_stiffness, s1 = bristle_damping. Source: Canudas de Wit, Olsson,
    Astrom, Lischinsky (1995), IEEE TAC 40(3), eqs. (1)-(4).
    """

    states = (*Linear.states, Variable(name="deflection", unit="rad"))
    bristle_state = 2

    bristle_stiffness: float = parameter(500.0, 1.0, 1e5, unit="1/s^2", description="of the bristles")
    bristle_damping: float = parameter(1.0, 0.0, 200.0, spread=10.0, unit="1/s", description="of the bristles")

    def law(self, operations: Operations) -> Law:
        friction_level = stribeck(operations)

        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            rates = (x[1], p.gain * (u[0] - p.centre) - p.stiffness * x[0], 0.0)
            level = friction_level(x[1], p.coulomb, p.coulomb + p.static_excess, p.stribeck_speed)
            return rates, (level, p.bristle_stiffness, p.bristle_damping, p.damping)

        return law
