"""A one-joint rig with Dahl's friction."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import Bristles, bounded
from hybrid_sysid_ros.models.linear import Linear


@dataclass(frozen=True, kw_only=True)
class Dahl(Linear):
    """v' = gain (u - centre) - stiffness q - damping v - s0 z,  z' = v (1 - s0 z / Fc sgn v), per unit inertia.

    z: deflection of the bristles, hidden; s0 = bristle_stiffness, Fc = coulomb. Source: Dahl (1968), with exponent 1.
    """

    contacts = (Bristles(on="velocity", level="coulomb", stiffness="bristle_stiffness", viscous="damping"),)

    coulomb: float = bounded(1.0, 0.0, 100.0, unit="rad/s^2")
    """Friction level."""
    bristle_stiffness: float = bounded(500.0, 1.0, 1e5, unit="1/s^2")
    """Of the bristles."""
