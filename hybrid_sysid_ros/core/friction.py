"""Dry-friction levels, for rigs and models alike. Each factory returns the level in the form the operations make."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.core.operations import Operation, Operations


def stribeck(operations: Operations) -> Operation:
    """Level F(v) = Fc + (Fs - Fc) exp(-(v / vs)^2) [units of Fc].

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30(7), eq. (3) with exponent 2. The sign of
    the velocity is applied by the integration step.
    """
    exp = operations.exp

    def level(v: Any, coulomb: Any, static: Any, speed: Any) -> Any:
        ratio = v / speed
        return coulomb + (static - coulomb) * exp(-ratio * ratio)

    return operations.function(level)


def rational_stribeck(operations: Operations) -> Operation:
    """Level F(v) = Fc + dF / (1 + (v / vs)^2)^2 [units of Fc]: a Stribeck curve with a heavier tail and no exp()."""

    def level(v: Any, coulomb: Any, excess: Any, speed: Any) -> Any:
        ratio = v / speed
        bell = 1.0 + ratio * ratio
        return coulomb + excess / (bell * bell)

    return operations.function(level)
