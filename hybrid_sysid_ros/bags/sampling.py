"""Sampling: stamps of messages put on a uniform grid, and signals of other topics brought onto it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

JITTER = 0.2  # largest distance of a stamp from the uniform grid, in sampling times
GAP = 1.5  # an interval longer than this many sampling times is a gap
PERIOD_TOLERANCE = 0.02  # relative deviation from the expected sampling time
FEWEST = 3  # samples of a record


class SamplingError(ValueError):
    """The stamps are not those of a uniform sampling; the text says where and what to do."""


def uniform_period(stamps: NDArray[np.int64], *, expected: float | None = None) -> float:
    """Sampling time [s] of stamps (samples,) [ns] that lie on a uniform grid but for a little jitter.

    Raises:
        SamplingError: too few samples, reversed or repeated stamps, a gap, irregular sampling, or not the expected one.
    """
    if len(stamps) < FEWEST:
        raise SamplingError(f"only {len(stamps)} samples: a record needs {FEWEST} or more")
    seconds = (stamps - stamps[0]) * 1e-9
    steps = np.diff(seconds)
    _check_order(steps, seconds)
    median = float(np.median(steps))
    if (steps > GAP * median).any():
        k = int(np.argmax(steps > GAP * median))
        missing = round(steps[k] / median) - 1
        raise SamplingError(
            f"gap of {steps[k]:.6g} s after sample {k} ({seconds[k]:.6g} s), about {missing} samples missing: "
            f"cut the bag there or record it again"
        )
    period, start = np.polyfit(np.arange(len(seconds)), seconds, 1)
    distance = np.abs(seconds - start - period * np.arange(len(seconds)))
    if (distance > JITTER * median).any():
        k = int(np.argmax(distance))
        raise SamplingError(
            f"sampling is not uniform: sample {k} ({seconds[k]:.6g} s) is {distance[k]:.3g} s off a grid of "
            f"{period:.6g} s: let the driver stamp messages when it samples"
        )
    if expected is not None and abs(period - expected) > PERIOD_TOLERANCE * expected:
        raise SamplingError(f"sampling time is {period:.6g} s where {expected:.6g} s is expected: check signals.period")
    return _rounded(float(period), len(stamps))


def mean_held(
    stamps: NDArray[np.float64], values: NDArray[np.float64], edges: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean of a held signal over each interval between two edges.

    stamps: (values,) s, rising; values[j] holds from stamps[j] to stamps[j+1], the last one from then on.
    edges: (intervals + 1,) s, rising, the first not before stamps[0].
    """
    inside = stamps[(stamps > edges[0]) & (stamps < edges[-1])]
    breaks = np.unique(np.concatenate([edges, inside]))
    held = values[np.searchsorted(stamps, breaks[:-1], side="right") - 1]
    widths = np.diff(breaks)
    starts = np.searchsorted(breaks, edges[:-1])
    mean: NDArray[np.float64] = np.add.reduceat(held * widths, starts) / np.add.reduceat(widths, starts)
    return mean


def last_before(stamps: NDArray[np.int64], values: NDArray[np.float64], at: NDArray[np.int64]) -> NDArray[np.float64]:
    """Most recent value at each time, NaN before the first; stamps (values,), at (samples,), both [ns]."""
    order = np.argsort(stamps, kind="stable")
    found = np.searchsorted(stamps[order], at, side="right") - 1
    return np.where(found >= 0, values[order][np.maximum(found, 0)], np.nan)


def _check_order(steps: NDArray[np.float64], seconds: NDArray[np.float64]) -> None:
    if (steps > 0).all():
        return
    k = int(np.argmax(steps <= 0)) + 1
    if steps[k - 1] == 0:
        raise SamplingError(
            f"repeated stamp at sample {k} ({seconds[k]:.6g} s): "
            f"two publishers on the topic, or a driver that stamps twice: record it with one"
        )
    raise SamplingError(
        f"reversed stamp at sample {k}: {seconds[k]:.6g} s after {seconds[k - 1]:.6g} s: "
        f"the clock was set back, or messages were recorded out of order: cut the bag there"
    )


def _rounded(period: float, samples: int) -> float:
    """Whole nanoseconds, where that does not move the last sample by more than a tenth of the jitter."""
    nearest = round(period, 9)
    return nearest if abs(nearest - period) * samples < 0.1 * JITTER * period else period
