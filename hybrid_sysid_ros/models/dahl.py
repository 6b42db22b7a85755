"""A one-joint rig with Dahl's friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.core import Law, Operations, Variable, parameter
from hybrid_sysid_ros.models.linear import Linear


@dataclass(frozen=True, kw_only=True)
class Dahl(Linear):
    """v' = gain (u - centre) - stiffness q - damping v - s0 z,  z' = v (1 - s0 z / Fc sgn v), per unit inertia.

    z: deflection of the bristles, hidden; s0 = bristle_stiffness, Fc = coulomb. Source: Dahl (1968), with exponent 1.
    """

    states = (*Linear.states, Variable(name="deflection", unit="rad"))
    bristle_state = 2

    coulomb: float = parameter(1.0, 0.0, 100.0, unit="rad/s^2", description="friction level")
    bristle_stiffness: float = parameter(500.0, 1.0, 1e5, unit="1/s^2", description="of the bristles")

    def law(self, operations: Operations) -> Law:
        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            rates = (x[1], p.gain * (u[0] - p.centre) - p.stiffness * x[0], 0.0)
            return rates, (p.coulomb, p.bristle_stiffness, 0.0, p.damping)

        return law
