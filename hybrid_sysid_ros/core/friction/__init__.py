"""Friction on one velocity. It is set-valued or stiff, so a right-hand side can't contain it: each step solves for it.

All levels are per unit inertia of their velocity. A field of a contact is a number, the name of a parameter or of a
method(x, u) of the system, or a function(system, x, u).

    Viscous      v' = f_v - D v
    Dry          v' = f_v - F sat(v / vc) - D v
    Ageing       v' = f_v - (F + Fe (1 - r)) sat(v / vc) - D v,  r' = |v| (1 - r) / L - r / T
    Hysteretic   v' = f_v - F(v, v') sat(v / vc) - D v
    Bristles     v' = f_v - s0 z - s1 z' - D v,  z' = v - |v| z s0 / F
    MaxwellSlip  v' = f_v - sum k_i z_i - D v,  z_i' = v until |k_i z_i| = c_i F, then it slips

Dry, Ageing and Hysteretic friction may have a direction d: F (1 + d) against a push upwards, F (1 - d) downwards.

F: level, vc: creep speed (0: it sticks exactly), D: viscous rate; z: deflection of bristles or elements. Each contact
solves its step exactly; for solvers that need derivatives it solves a smoothed one.

Functions such as :func:`stribeck` give the level over the speed.
"""

from hybrid_sysid_ros.core.friction.contact import Contact, Field, Viscous, rational_stribeck, stefanski, stribeck
from hybrid_sysid_ros.core.friction.dry import Ageing, Dry, Hysteretic
from hybrid_sysid_ros.core.friction.presliding import Bristles, MaxwellSlip, fading_stiffnesses

__all__ = [
    "Ageing",
    "Bristles",
    "Contact",
    "Dry",
    "Field",
    "Hysteretic",
    "MaxwellSlip",
    "Viscous",
    "fading_stiffnesses",
    "rational_stribeck",
    "stefanski",
    "stribeck",
]
