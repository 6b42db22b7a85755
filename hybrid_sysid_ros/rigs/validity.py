"""Validity: the range in which the equations of a rig are valid."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

ROUNDING = 1e-9
"""Rounding of an input, relative to its actuator's range."""


def check_valid(rig: Rig, states: NDArray[np.float64], what: str, *, system: System | None = None) -> None:
    """Raise UserError for states (samples, states) outside the rig's range of validity, naming the state.

    what: beginning of the message. system: the system of the states, by default the rig's; states that the rig does not
    have are not limited.
    """
    if rig.validity is None:
        return
    low, high = rig.validity
    columns = {item.name: column for column, item in enumerate((system or rig.system).states)}
    for index, item in enumerate(rig.system.declared_states):
        if item.name not in columns:
            continue
        values = states[:, columns[item.name]]
        outside = np.flatnonzero((values < low[index]) | (values > high[index]))
        if len(outside):
            worst = values[outside[int(np.argmax(np.abs(values[outside])))]]
            shown = [_shown(value, item.unit) for value in (worst, low[index], high[index])]
            raise UserError(
                f"{what}: {item.name} is {shown[0]}, and {rig.name} is valid from {shown[1]} to {shown[2]} only"
                f"{_deviations(rig, item.name)}; stay within, or correct validity in its rig.yaml"
            )


def check_reached(rig: Rig, inputs: NDArray[np.float64], what: str) -> None:
    """Raise UserError for inputs (inputs,) that the rig's actuators can't give, naming the input."""
    for value, item, actuator in zip(inputs, rig.system.inputs, rig.actuators, strict=True):
        if abs(value - min(max(value, actuator.low), actuator.high)) > ROUNDING * (actuator.high - actuator.low):
            shown = [_shown(number, item.unit) for number in (value, actuator.low, actuator.high)]
            raise UserError(
                f"{what}: needs {item.name} {shown[0]}, and its actuator gives {shown[1]} to {shown[2]} only"
                f"{_deviations(rig, item.name)}; hold other values"
            )


def _deviations(rig: Rig, name: str) -> str:
    whole = rig.system.operating_point.get(name)
    return f", as deviations from {whole:.6g}" if whole else ""


def _shown(value: float, unit: str) -> str:
    """A number with its unit, and an angle also in degrees."""
    degrees = f" ({math.degrees(value):.3g} deg)" if unit == "rad" else ""
    return f"{value:.4g}{'' if unit == '1' else f' {unit}'}{degrees}"
