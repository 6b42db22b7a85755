"""Levels of dry friction over speed, for rigs and models alike."""

from __future__ import annotations

from hybrid_sysid_ros.core.mathematics import Scalar, absolute, exp, select


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


def stefanski(
    v: Scalar,
    acceleration: Scalar,
    coulomb: Scalar,
    static: Scalar,
    speed_shape: Scalar,
    acceleration_shape: Scalar,
    *,
    growing: Scalar | None = None,
) -> Scalar:
    """Level F(v, v') = Fc + (Fs - Fc) exp(-a1 |v| / (|v'| + a2)) sgn(v v') [units of Fc]: higher while the speed grows
    than while it falls, so that friction over speed is a loop.

    At rest it is the static level. growing: sgn(v v') where it is rounded. Source: Wojewoda, Stefanski, Wiercigroch,
    Kapitaniak (2008), Phil. Trans. R. Soc. A 366, 747-765, on hysteretic dry friction; the formula is given as it is
    commonly quoted, and was not compared with the paper's own print.
    """
    decay = exp(-speed_shape * absolute(v) / (absolute(acceleration) + acceleration_shape))
    if growing is None:
        growing = select(v * acceleration < 0.0, -1.0, 1.0)
    return coulomb + (static - coulomb) * decay * growing
