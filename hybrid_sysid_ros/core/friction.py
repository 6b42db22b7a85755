"""Levels of dry friction over speed, for rigs and models alike."""

from __future__ import annotations

from hybrid_sysid_ros.core.mathematics import Scalar, exp


def stribeck(v: Scalar, coulomb: Scalar, static: Scalar, speed: Scalar) -> Scalar:
    """Level F(v) = Fc + (Fs - Fc) exp(-(v / vs)^2) [units of Fc].

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), eq. (3) with exponent 2. The sign of
    the velocity is applied by the contact.
    """
    ratio = v / speed
    return coulomb + (static - coulomb) * exp(-ratio * ratio)


def rational_stribeck(v: Scalar, coulomb: Scalar, excess: Scalar, speed: Scalar) -> Scalar:
    """Level F(v) = Fc + dF / (1 + (v / vs)^2)^2 [units of Fc]: a Stribeck curve with a heavier tail and no exp()."""
    ratio = v / speed
    bell = 1.0 + ratio * ratio
    return coulomb + excess / (bell * bell)
