"""References from the parameters of the node `reference`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_sysid_ros.rigs.excitation import Reference, constant, multisine, random_steps, sine
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.signal_file import is_signal_file, output_columns, read_signals
from hybrid_sysid_ros.support.errors import UserError

KINDS = ("constant", "steps", "sine", "multisine")
LONGEST = 3600.0  # s of steps that are drawn; the last one is held
LOWEST = 0.05  # Hz, of the multisine
MULTISINE_PERIOD = 20.0  # s
LINES = 20  # of the multisine


def signal_of(kind: str, settings: Mapping[str, Any], rig: Rig) -> Reference:
    """The reference of a kind with the parameters: a function of times [s] (any shape) with outputs (..., p) in display
    units. A kind that ends with .csv is a file of signals, whose tracked outputs are followed.

    Raises UserError for an unknown kind, a file that does not fit or leaves the rig's reach, and a multisine without
    room between its frequencies.
    """
    if is_signal_file(kind):
        return _of_file(kind, rig)
    if kind in rig.references:
        return rig.references[kind]
    if kind not in KINDS:
        known = ", ".join((*KINDS, *rig.references))
        raise UserError(f"parameter kind is {kind!r}: choose one of {known}, or a file of signals (.csv)")
    if kind == "multisine" and settings["frequency"] <= LOWEST:
        raise UserError(
            f"parameter frequency is {settings['frequency']:g} Hz: a multisine needs more than {LOWEST:g} Hz"
        )
    signals = [_signal(kind, settings, k, amplitude) for k, amplitude in enumerate(settings["amplitude"])]
    return lambda t: np.stack([signal(t) for signal in signals], axis=-1)


def _of_file(path: str, rig: Rig) -> Reference:
    """The outputs in a file of signals, by lines between its samples."""
    given = read_signals(path, columns := output_columns(rig))
    for (name, unit), shown, ends in zip(columns, rig.display, rig.reach.T, strict=True):
        values, (low, high) = given.columns[name], sorted(shown.shown(ends).tolist())
        if values.min() < low or values.max() > high:
            raise UserError(
                f"{path}: {name} goes from {values.min():.4g} to {values.max():.4g} {unit}; the rig reaches "
                f"{low:.4g} to {high:.4g}"
            )
    return lambda t: given.joined([name for name, _ in columns], t)


def length_of(kind: str, rig: Rig) -> float:
    """Length of a reference by itself [s]; 0: it does not end. Raises UserError for a file that does not fit."""
    if is_signal_file(kind):
        return read_signals(kind, output_columns(rig)).duration
    return rig.references[kind].duration if kind in rig.references else 0.0


def _signal(kind: str, settings: Mapping[str, Any], output: int, amplitude: float) -> Reference:
    """The reference of one output; each output has random numbers of its own."""
    frequency, seed = settings["frequency"], settings["seed"] + output
    if kind == "constant" or amplitude == 0.0:
        return constant(level=amplitude)
    if kind == "steps":
        duration = settings["duration"] or LONGEST
        return random_steps(seed, amplitude=abs(amplitude), hold=settings["hold"], duration=duration)
    if kind == "sine":
        return sine(amplitude=amplitude, frequency=frequency)
    return multisine(seed, amplitude=amplitude, low=LOWEST, high=frequency, lines=LINES, period=MULTISINE_PERIOD)
