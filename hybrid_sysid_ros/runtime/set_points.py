"""Set-points and references: what may be asked of a rig's outputs while it runs, whoever asks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.rigs.excitation import Reference, constant, multisine, random_steps, sine
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults
from hybrid_sysid_ros.support.errors import UserError

KINDS = ("constant", "steps", "sine", "multisine")
LONGEST = 3600.0  # s of steps that are drawn; the last one is held
LOWEST = 0.05  # Hz, of the multisine
MULTISINE_PERIOD = 20.0  # s
LINES = 20  # of the multisine
REACH = 2.0
"""Times the rig's own amplitude of references, within which set-points are."""


@dataclass(frozen=True, kw_only=True)
class Output:
    """An output as it is shown, and where its set-points may be; NaN where it is not tracked."""

    name: str
    unit: str
    scale: float
    """SI per unit."""
    tracked: bool
    low: float = math.nan
    high: float = math.nan

    @property
    def moves(self) -> bool:
        """Whether it may be sent anywhere: one whose references have no amplitude is weighed, but belongs at 0."""
        return self.high > self.low


def outputs_of(rig: Rig) -> tuple[Output, ...]:
    """The outputs of a rig: set-points lie within its travel, less a margin, and within REACH of its own amplitude."""
    weights = defaults(rig, "controller")["output_weight"]
    amplitudes = defaults(rig, "reference")["amplitude"]
    found = []
    for item, display, weight, amplitude, reach in zip(
        rig.system.outputs, rig.display, weights, amplitudes, rig.reach.T, strict=True
    ):
        low = high = math.nan
        if weight > 0.0:
            low, high = sorted((reach / display.scale).tolist())
            most = REACH * abs(amplitude)
            low, high = max(low, -most), min(high, most)
        found.append(
            Output(name=item.name, unit=display.unit, scale=display.scale, tracked=weight > 0.0, low=low, high=high)
        )
    return tuple(found)


def signal_of(kind: str, settings: Mapping[str, Any], rig: Rig) -> Reference:
    """The reference of a kind by the parameters: seconds in (any shape), the outputs as they are shown out (..., p).
    Raises UserError where there is no such kind, or the multisine has no room between its lowest and highest frequency.
    """
    if kind in rig.references:
        return rig.references[kind]
    if kind not in KINDS:
        raise UserError(f"parameter kind is {kind!r}: choose one of {', '.join((*KINDS, *rig.references))}")
    if kind == "multisine" and settings["frequency"] <= LOWEST:
        raise UserError(
            f"parameter frequency is {settings['frequency']:g} Hz: a multisine needs more than {LOWEST:g} Hz"
        )
    signals = [_signal(kind, settings, k, amplitude) for k, amplitude in enumerate(settings["amplitude"])]
    return lambda t: np.stack([signal(t) for signal in signals], axis=-1)


def _signal(kind: str, settings: Mapping[str, Any], output: int, amplitude: float) -> Reference:
    """One output's reference; those of several differ in what is random."""
    frequency, seed = settings["frequency"], settings["seed"] + output
    if kind == "constant" or amplitude == 0.0:
        return constant(level=amplitude)
    if kind == "steps":
        duration = settings["duration"] or LONGEST
        return random_steps(seed, amplitude=abs(amplitude), hold=settings["hold"], duration=duration)
    if kind == "sine":
        return sine(amplitude=amplitude, frequency=frequency)
    return multisine(seed, amplitude=amplitude, low=LOWEST, high=frequency, lines=LINES, period=MULTISINE_PERIOD)
