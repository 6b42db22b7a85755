"""Grid: the uneven, doubled and missing stamps of a log become samples at even times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.gaps import GAP, LONGEST_GAP
from hybrid_sysid_ros.bags.sampling import FEWEST, JITTER
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError, counted

MOST_WRONG = 0.05
"""Share of stamps that may be doubled or out of order; with more the column is no time."""
SAMPLES_PER_PIECE = 20
"""Fewest samples of a piece between two long gaps that is kept."""
NEAR = 0.75
"""Distance [sampling times] of a sample from the nearest stamp above which it counts as missing."""
COMMON = 0.05
"""Share by which the mean step of uneven stamps may be off a whole part of the rig's scored period to be sampled so: a
logger's records differ by less, and a model of one is to judge the others.
"""
RARE = 1.5
"""Steps between an output's values, in those of the rows, from which it is slower."""
SHORTEST, LONGEST = 1e-8, 9e9
"""Shortest sampling time and longest record [s]: bags count nanoseconds, in 64 bits."""
HOUR = 3600.0
JITTERS = 3.0
"""Sampling times by which stamps that jitter step back at most; a clock that was set back by less is not told apart."""
MOST_SAMPLES_PER_STAMP = 20
"""Most samples per stamp: one stamp far away must not make a grid that fills the memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CleanStamps:
    """Rising times of the rows that are kept, and what was repaired, a sentence each."""

    rows: NDArray[np.intp]
    times: Array
    """Of these rows, (rows,) [s]."""
    notes: list[str]


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleGrid:
    """Even times at which the record is sampled."""

    period: float
    times: Array
    """(samples,) [s]."""
    measured: NDArray[np.bool_]
    """Samples with a stamp nearby, (samples,)."""
    even: bool
    """Whether each stamp is one of these times but for a little jitter, so that nothing is interpolated."""

    def pieces(self) -> Iterator[slice]:
        """Parts between gaps of more than :data:`~hybrid_sysid_ros.bags.gaps.LONGEST_GAP` samples."""
        present = np.flatnonzero(self.measured)
        breaks = np.flatnonzero(np.diff(present) > LONGEST_GAP + 1)
        for first, last in zip([0, *(breaks + 1)], [*breaks, len(present) - 1], strict=True):
            if present[last] - present[first] + 1 >= SAMPLES_PER_PIECE:
                yield slice(int(present[first]), int(present[last]) + 1)


def clean_stamps(seconds: Array, what: str) -> CleanStamps:
    """Rising times out of a column of times [s]. what: name of the column, for errors.

    Raises UserError for a column that is no time.
    """
    rows = np.flatnonzero(np.isfinite(seconds))
    notes = []
    if not len(rows):
        raise UserError(
            f"{what}: none of its {len(seconds)} values is a number, or a date such as 2024-01-31 10:00:00.5; name "
            "another column, or give the period of the samples"
        )
    if len(rows) < FEWEST:
        raise UserError(f"{what}: has {len(rows)} times: a record needs {FEWEST} or more")
    if lost := len(seconds) - len(rows):
        notes.append(f"{what}: {lost} rows have no time; they are left out")
    times = seconds[rows]
    steps = np.diff(times)
    back = int((steps < 0).sum())
    if back > MOST_WRONG * len(steps):
        raise UserError(f"{what}: {back} of {len(steps)} steps go backwards: it is no time; name another column")
    if back:
        k = int(np.argmax(steps < 0)) + 1
        first, peak = rows[k], np.maximum.accumulate(times)
        behind = int(np.diff(np.flatnonzero(np.append(times >= peak, True))).max()) - 1
        twice = _overlap(times, steps)
        k, first = (twice, rows[twice]) if twice else (k, first)
        if behind > SAMPLES_PER_PIECE or twice or (back == 1 and times[-1] < times[k - 1]):
            hint = _summer(-steps[k - 1], float(np.median(np.abs(steps))))
            raise UserError(
                f"{what}: the clock was set back by {-steps[k - 1]:.6g} s at row {first}, or another run begins "
                f"there{hint}; cut the file there, since nothing says how the two parts follow each other"
            )
        order = np.argsort(times, kind="stable")
        rows, times = rows[order], times[order]
        notes.append(f"{what}: {back} times go backwards, the first at row {first}; the rows are sorted by time")
    doubled = np.append(False, np.diff(times) == 0.0)
    if doubled.sum() > MOST_WRONG * len(times):
        spread = _coarse(times)
        if spread is None:
            raise UserError(
                f"{what}: {doubled.sum()} of {len(times)} times are there twice, unevenly: two devices wrote into one "
                "file, or it is no time; name another column, or give the period of the samples"
            )
        notes.append(
            f"{what}: each time stands for several rows, since it counts only {spread[1]:.3g} s; the rows are spread "
            f"evenly, {spread[0][1] - spread[0][0]:.6g} s apart"
        )
        times = spread[0]
    elif doubled.any():
        k = int(np.argmax(doubled))
        notes.append(
            f"{what}: {doubled.sum()} times are there twice, the first at row {rows[k]} ({times[k]:.6g} s); the first "
            "row of each is kept"
        )
        rows, times = rows[~doubled], times[~doubled]
    return CleanStamps(rows=rows, times=times, notes=notes)


def _overlap(times: Array, steps: Array) -> int:
    """The first row behind a step back within which two parts lie over each other, so that it has about twice as many
    rows as samples; 0 where rows are merely out of order, as by a jitter of the stamps.
    """
    period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
    back = np.flatnonzero(steps < -JITTERS * period) + 1
    ordered, low, high = np.sort(times), times[back], times[back - 1]
    rows = np.searchsorted(ordered, high, "right") - np.searchsorted(ordered, low, "left")
    twice = back[rows > 1.5 * ((high - low) / period + 1.0)]
    return int(twice[0]) if len(twice) else 0


def _summer(jump: float, period: float) -> str:
    """A guess at the cause of a jump by an hour."""
    return " (an hour: is it summer time? write times in UTC)" if abs(jump - HOUR) <= 2.0 * period else ""


def known_stamps(stamps: CleanStamps, values: Array, missing: float | None) -> CleanStamps:
    """The stamps of a column's values (rows,) that are numbers and not ``missing``, which stands for none; all stamps,
    where hardly one is.
    """
    inside = stamps.rows[stamps.rows < len(values)]
    known = np.isfinite(values[inside]) & (values[inside] != missing)
    if known.sum() < FEWEST:
        return stamps
    return replace(stamps, rows=inside[known], times=stamps.times[: len(inside)][known])


def sampling_stamps(stamps: Mapping[str, CleanStamps], every: CleanStamps, what: str) -> CleanStamps:
    """The stamps by which a record is sampled: those of every row, or of the output that comes so much more rarely that
    straight lines between its values would pass for measurements. what: for its note.
    """
    steps = {name: float(np.median(np.diff(its.times))) for name, its in stamps.items()}
    name = max(steps, key=steps.__getitem__)
    if not steps[name] > RARE * float(np.median(np.diff(every.times))):
        return every
    note = (
        f"{what}: {name} comes only every {steps[name]:.4g} s: the record is sampled so, with the inputs' means between"
    )
    return replace(stamps[name], notes=[*every.notes, note])


def _coarse(times: Array) -> tuple[Array, float] | None:
    """Even times for stamps that are only rounded too coarsely, and that rounding [s]; None for others."""
    distinct = np.unique(times)
    if len(distinct) < FEWEST:
        return None
    resolution = float(np.median(np.diff(distinct)))
    period = (times[-1] - times[0]) / (len(times) - 1)
    even = times[0] + period * np.arange(len(times))
    away = even - times
    return (even - np.median(away), resolution) if np.ptp(away) <= 3.0 * resolution else None


def grid_of(stamps: CleanStamps, what: str, *, scored: float | None = None) -> SampleGrid:
    """Even times for rising stamps. scored: period [s] of which uneven steps become a whole part, if one is near.

    Raises UserError where the stamps belong to no even sampling at all.
    """
    times, notes = stamps.times, stamps.notes
    steps = np.diff(times)
    period = float(np.median(steps))
    span = float(times[-1] - times[0])
    if period < SHORTEST or span > LONGEST:
        raise UserError(
            f"{what}: samples are {period:.3g} s apart, over {span:.3g} s, which no bag can hold; is it in "
            "another unit (--unit time=us), or is the period another one?"
        )
    near = np.abs(steps - period) < 0.5 * period
    if near.any():
        period = float(steps[near].mean())
    whole = np.round(np.append(0.0, np.cumsum(np.maximum(np.round(steps / period), 1.0))))
    fitted, away = _line(whole, times)
    even = bool(near.mean() > 0.5 and away.max() <= JITTER * fitted)
    if even:
        period, origin = _rounded(fitted, int(whole[-1]), float(away.max())), float(times[0])
        samples = int(whole[-1]) + 1
    else:
        origin = float(times[0])
        if scored is not None:
            part = scored / max(round(scored / period), 1)
            period = part if abs(part - period) <= COMMON * period else period
        samples = int((times[-1] - origin) / period + 1e-6) + 1
    if samples > MOST_SAMPLES_PER_STAMP * len(times):
        k = int(np.argmax(steps))
        raise UserError(
            f"{what}: jumps by {steps[k]:.6g} s after row {stamps.rows[k]}, and samples are {period:.3g} s apart; "
            "cut the file there"
        )
    grid = origin + period * np.arange(samples, dtype=np.float64)
    measured = np.zeros(samples, dtype=bool)
    if even:
        measured[whole.astype(np.intp)] = True
    else:
        at = np.searchsorted(times, grid)
        before, after = times[np.maximum(at - 1, 0)], times[np.minimum(at, len(times) - 1)]
        measured = np.minimum(np.abs(grid - before), np.abs(after - grid)) <= NEAR * period
        within = steps[steps <= GAP * period]
        steady = len(within) < len(steps) and np.abs(within - period).max() <= JITTER * period
        cause = (
            "a gap is no whole number of samples"
            if steady
            else f"times are uneven, steps of {np.percentile(steps, 5):.3g} to {np.percentile(steps, 95):.3g} s"
        )
        notes.append(f"{what}: {cause}; signals are interpolated at steps of {period:.6g} s")
    gaps = steps[steps > GAP * period]
    if len(gaps) and not measured.all():
        k = int(np.argmax(steps > GAP * period))
        notes.append(
            f"{what}: {counted(len(gaps), 'gap')}, up to {gaps.max():.4g} s, the first after row {stamps.rows[k]} "
            f"({times[k]:.6g} s){_summer(float(steps[k]), period)}"
        )
    return SampleGrid(period=period, times=grid, measured=measured, even=even)


def _line(counts: Array, times: Array) -> tuple[float, Array]:
    """The period of the line t = t_0 + period n through times at counts n of samples, and how far each is off it."""
    centred = counts - counts.mean()
    period = float(centred @ (times - times.mean()) / (centred @ centred))
    return period, np.abs(times - times.mean() - period * centred)


def _rounded(period: float, samples: int, away: float) -> float:
    """The period in the fewest digits that keep the last sample as near as the stamps are to even times, or else in
    whole nanoseconds, where that moves it by little.
    """
    for digits in range(1, 10):
        nearest = float(f"{period:.{digits}g}")
        if abs(nearest - period) * samples <= min(away, 0.1 * JITTER * period):
            return nearest
    nearest = round(period, 9)
    return nearest if nearest and abs(nearest - period) * samples < 0.1 * JITTER * period else period
