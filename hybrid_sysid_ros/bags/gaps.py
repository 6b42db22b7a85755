"""Gaps: samples that a recording lacks. They are found by stamps and filled in, so that all others keep their times."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

GAP = 1.5  # an interval longer than this many sampling times is a gap
LONGEST_GAP = 50  # samples that may be missing in a row
MOST_MISSING = 0.1  # share of all samples that may be missing

Filler = Literal["line", "preceding", "following", "unknown"]
"""How a gap is filled: a straight line between the neighbours, the next value, the last one, or NaN."""


class SamplingError(ValueError):
    """The stamps are not those of a uniform sampling; the text says where and what to do."""


def missing_before(
    stamps: NDArray[np.int64], period: float, *, number: int = 0, origin: int | None = None
) -> NDArray[np.int64]:
    """How many samples are missing before each of rising stamps (samples,) [ns] but the first, (samples - 1,).

    period: sampling time [s]. The message uses the number of the first sample and the stamp of time 0 (origin) [ns].

    Raises SamplingError where more than LONGEST_GAP samples are missing in a row.
    """
    steps = np.diff(stamps) * 1e-9 / period
    missing = np.where(steps > GAP, np.round(steps) - 1, 0).astype(np.int64)
    if (missing <= LONGEST_GAP).all():
        return missing
    k = int(np.argmax(missing > LONGEST_GAP))
    seconds = (stamps[k] - (stamps[0] if origin is None else origin)) * 1e-9
    raise SamplingError(
        f"gap of {steps[k] * period:.6g} s after sample {number + k} ({seconds:.6g} s), about {missing[k]} samples "
        f"missing, more than {LONGEST_GAP}: cut the bag there or record it again"
    )


class FilledBlock:
    """Messages of a block; `missing` (messages,) is the number of missing samples before each."""

    def __init__(self, missing: NDArray[np.int64]) -> None:
        self._counts = missing + 1
        self._places = np.cumsum(self._counts) - 1

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Which samples have a message, (samples,)."""
        found = np.zeros(int(self._places[-1]) + 1, dtype=bool)
        found[self._places] = True
        return found

    def filled(self, values: NDArray[np.float64], previous: float, by: Filler) -> NDArray[np.float64]:
        """Values of the samples (samples,) from those of the messages (messages,); previous: the last value of the
        previous block, for a gap between the blocks.
        """
        if len(self.measured) == len(values):
            return values
        if by == "preceding":
            return np.repeat(values, self._counts)
        known, at = np.append(previous, values), np.append(-1, self._places)
        samples = np.arange(len(self.measured))
        if by == "line":
            return np.interp(samples, at, known)
        held = known[np.searchsorted(at, samples, side="right") - 1]
        return held if by == "following" else np.where(self.measured, held, np.nan)
