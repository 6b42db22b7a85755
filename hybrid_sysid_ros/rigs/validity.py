"""Validity: where the equations of a rig mean something."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError


def check_valid(rig: Rig, states: NDArray[np.float64], what: str) -> None:
    """Raise UserError for states (samples, states) that leave the validity of the rig, with the state that does.

    what: has them, as the message begins.
    """
    if rig.validity is None:
        return
    low, high = rig.validity
    for index, item in enumerate(rig.system.declared_states):
        values = states[:, index]
        outside = np.flatnonzero((values < low[index]) | (values > high[index]))
        if len(outside):
            worst = values[outside[int(np.argmax(np.abs(values[outside])))]]
            told = [_shown(value, item.unit) for value in (worst, low[index], high[index])]
            raise UserError(
                f"{what}: {item.name} is {told[0]}, and {rig.name} is valid from {told[1]} to {told[2]} only; "
                "stay within, or correct validity in its rig.yaml"
            )


def _shown(value: float, unit: str) -> str:
    """A number with its unit, an angle in degrees too."""
    degrees = f" ({math.degrees(value):.3g} deg)" if unit == "rad" else ""
    return f"{value:.4g} {unit}{degrees}"
