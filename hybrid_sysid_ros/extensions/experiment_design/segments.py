"""Segments: the pieces of which an experiment is made, each a signal of rig.yaml in shares of what its input can do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.support.arrays import Array

LEVELS = (-1.0, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 1.0)
AMPLITUDES = (0.1, 0.25, 0.5, 1.0)
"""In shares of what an input can do."""
LINES = 12
"""Sines of a multisine."""
TWEAK = 0.4
"""Deviation of the logarithm of a number that is changed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanSegment:
    """A signal over a stretch of time, in shares from -1 to 1."""

    excitation: Excitation
    seed: int = 0

    def values(self, times: Array, length: float) -> Array:
        """At times from its beginning [s], (samples,)."""
        return np.clip(self.excitation.signal(seed=self.seed, duration=length)(times), -1.0, 1.0)

    @property
    def content(self) -> dict[str, Any]:
        """Kind and numbers as plain data, in shares."""
        return {"kind": self.excitation.kind, **{key: float(f"{v:.4g}") for key, v in self.excitation.numbers.items()}}


def segment(kind: str, *, seed: int = 0, **numbers: float) -> PlanSegment:
    """A segment of a kind and numbers, see :mod:`hybrid_sysid_ros.rigs.excitation`."""
    return PlanSegment(excitation=Excitation(kind=kind, numbers=numbers), seed=seed)


REST = segment("constant", level=0.0)


class SegmentLibrary:
    """Random segments of one length: levels, ramps, sines, sweeps, multisines and steps from slow to fast."""

    def __init__(self, *, length: float, fastest: float, random: np.random.Generator) -> None:
        """length: of a segment [s]. fastest: highest frequency [Hz]."""
        self.length, self.random = length, random
        self.lowest, self.fastest = 0.5 / length, max(fastest, 1.0 / length)

    def drawn(self) -> PlanSegment:
        """A new segment."""
        pick, seed = self.random, int(self.random.integers(1 << 30))
        amplitude = float(pick.choice(AMPLITUDES))
        low, high = sorted(np.exp(pick.uniform(np.log(self.lowest), np.log(self.fastest), 2)).tolist())
        kind = pick.choice(["constant", "ramp", "sine", "swept_sine", "multisine", "random_steps"])
        if kind == "constant":
            return segment("constant", level=float(pick.choice(LEVELS)))
        if kind == "ramp":
            return segment("ramp", first=float(pick.choice(LEVELS)), level=float(pick.choice(LEVELS)))
        if kind == "sine":
            return segment("sine", amplitude=amplitude, frequency=low)
        if kind == "swept_sine":
            return segment("swept_sine", amplitude=amplitude, low=low, high=high)
        if kind == "multisine":
            high = max(high, low + 2.0 / self.length)
            return segment("multisine", seed=seed, amplitude=amplitude, low=low, high=high, lines=LINES)
        hold = float(np.clip(0.5 / high, 0.5 / self.fastest, 0.5 * self.length))
        return segment("random_steps", seed=seed, amplitude=amplitude, hold=hold)

    def changed(self, given: PlanSegment) -> PlanSegment:
        """A segment near another one: each number a little larger or smaller, within what is possible."""
        ends = {
            **dict.fromkeys(("amplitude", "level", "first"), (-1.0, 1.0)),
            **dict.fromkeys(("low", "high", "frequency"), (self.lowest, self.fastest)),
            "hold": (0.5 / self.fastest, self.length), "lines": (LINES, LINES),
        }  # fmt: skip
        numbers = {}
        for name, value in given.excitation.numbers.items():
            factor = float(np.exp(TWEAK * self.random.normal()))
            numbers[name] = float(np.clip(value * factor, *ends[name]))
        if "low" in numbers:
            numbers["high"] = max(numbers["high"], numbers["low"])
        seed = given.seed if self.random.random() < 0.5 else int(self.random.integers(1 << 30))
        return PlanSegment(excitation=replace(given.excitation, numbers=numbers), seed=seed)
