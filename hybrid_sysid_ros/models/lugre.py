"""A one-joint rig with LuGre friction."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import Bristles, bounded
from hybrid_sysid_ros.models.stribeck import Stribeck


@dataclass(frozen=True, kw_only=True)
class LuGre(Stribeck):
    """v' = gain (u - centre) - stiffness q - damping v - s0 z - s1 z',  z' = v - |v| s0 z / F(v), per unit inertia,
    F(v) = Fc + (Fs - Fc) exp(-(v / vs)^2).

    z: deflection of the bristles, hidden; s0 = bristle_stiffness, s1 = bristle_damping. Source: Canudas de Wit, Olsson,
    Astrom, Lischinsky (1995), IEEE TAC 40(3), eqs. (1)-(4).
    """

    contacts = (
        Bristles(
            on="velocity",
            level="friction",
            stiffness="bristle_stiffness",
            damping="bristle_damping",
            viscous="damping",
        ),
    )

    bristle_stiffness: float = bounded(500.0, 1.0, 1e5, unit="1/s^2")
    """Of the bristles."""
    bristle_damping: float = bounded(1.0, 0.0, 200.0, spread=10.0, unit="1/s")
    """Of the bristles."""
