"""A one-joint rig with Stribeck's friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from hybrid_sysid_ros.core import Contact, Dry, bounded
from hybrid_sysid_ros.core.friction import stribeck
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.models.linear import Linear


@dataclass(frozen=True, kw_only=True)
class Stribeck(Linear):
    """v' = gain (u - centre) - stiffness q - damping v - [Fc + (Fs - Fc) exp(-(v / vs)^2)] sgn v, per unit inertia.

    The printed law of the lecture lost sgn(v); this is the corrected one. Fs = coulomb + static_excess.
    """

    contacts: ClassVar[tuple[Contact, ...]] = (Dry(on="velocity", level="friction", viscous="damping"),)

    coulomb: float = bounded(1.0, 0.0, 100.0, unit="rad/s^2")
    """Friction level at speed."""
    static_excess: float = bounded(0.2, 0.0, 100.0, spread=0.5, unit="rad/s^2")
    """Friction at rest above that level."""
    stribeck_speed: float = bounded(0.05, 0.005, 2.0, spread=0.05, unit="rad/s")
    """Speed at which the excess is gone."""

    def friction(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Scalar:
        """Level of the dry friction [rad/s^2]."""
        return stribeck(x[1], self.coulomb, self.coulomb + self.static_excess, self.stribeck_speed)
