"""Segments: the pieces of which an experiment is made, each a signal of rig.yaml in shares of what its input can do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.rigs.excitation import Excitation
from hybrid_sysid_ros.support.arrays import Array

LEVELS = (-1.0, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 1.0)
AMPLITUDES = (0.1, 0.25, 0.5, 1.0)
"""In shares of what an input can do."""
SIZES = ("amplitude", "level", "first")
"""Numbers of a signal that are in its unit."""
LINES = 12
"""Sines of a multisine."""
TWEAK = 0.4
"""Deviation of the logarithm of a number that is changed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanSegment:
    """A signal over a stretch of time, in shares from -1 to 1; it may be a stretch of a longer signal."""

    excitation: Excitation
    seed: int = 0
    begins: float = 0.0
    """Time of the signal at which the segment begins [s]."""
    whole: float = 0.0
    """Length of a longer signal [s]; 0: that of the segment."""

    def values(self, times: Array, length: float) -> Array:
        """At times from its beginning [s], (samples,)."""
        signal = self.excitation.signal(seed=self.seed, duration=self.whole or length)
        return np.clip(signal(self.begins + times), -1.0, 1.0)

    @property
    def content(self) -> dict[str, Any]:
        """Kind and numbers as plain data, in shares."""
        within = {"begins": self.begins, "whole": self.whole} if self.whole else {}
        numbers = {**self.excitation.numbers, **within}
        return {"kind": self.excitation.kind, **{key: float(f"{value:.4g}") for key, value in numbers.items()}}


def segment(kind: str, *, seed: int = 0, **numbers: float) -> PlanSegment:
    """A segment of a kind and numbers, see :mod:`hybrid_sysid_ros.rigs.excitation`."""
    return PlanSegment(excitation=Excitation(kind=kind, numbers=numbers), seed=seed)


REST = segment("constant", level=0.0)


def stretches(excitation: Excitation, *, unit: float, count: int, length: float) -> Sequence[PlanSegment]:
    """A signal as segments of one length [s] that follow each other. unit: share that 1 of its amplitudes is."""
    shares = {key: value * unit if key in SIZES else value for key, value in excitation.numbers.items()}
    whole = PlanSegment(excitation=replace(excitation, numbers=shares), whole=count * length)
    return [replace(whole, begins=number * length) for number in range(count)]


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
            **dict.fromkeys(SIZES, (-1.0, 1.0)),
            **dict.fromkeys(("low", "high", "frequency"), (self.lowest, self.fastest)),
            "hold": (0.5 / self.fastest, self.length),
        }  # fmt: skip
        numbers = dict(given.excitation.numbers)
        for name in numbers.keys() & ends.keys():
            factor = float(np.exp(TWEAK * self.random.normal()))
            numbers[name] = float(np.clip(numbers[name] * factor, *ends[name]))
        if "low" in numbers:
            numbers["high"] = max(numbers["high"], numbers["low"])
        seed = given.seed if self.random.random() < 0.5 else int(self.random.integers(1 << 30))
        return replace(given, excitation=replace(given.excitation, numbers=numbers), seed=seed)
