"""Time columns: which column of a log file has the times of its rows, by its name, its unit and its values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile, words_of
from hybrid_sysid_ros.extensions.importing.mapping import TimeColumn, seconds_of
from hybrid_sysid_ros.support.arrays import Array

TIME_UNITS = ("days", "hours", "minutes", "milliseconds", "microseconds")
"""Names of times that are units."""
TIMES = (
    "time", "t", "timestamp", "stamp", "seconds", "sec", "s", "zeit", "tempo", "temps", "tiempo", "elapsed", "clock",
    "date", "datetime", "ts", "epoch", "unixtime", "uhrzeit", "zeitstempel", "datum", "horodatage", "heure", "fecha",
    "hora", "ora", "instante", *TIME_UNITS,
)  # fmt: skip
SHORTEST = 3
"""Letters of a word from which it says time in any name; a shorter one is the whole name: t, and not T_jacket."""
PERIODS, RATES = (
    ("ts", "dt", "period", "sampletime", "samplingtime", "tsample"),
    ("fs", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency", "fsample"),
)
"""Names of a sampling time [s] and of a sampling rate [Hz], also of a single number."""
EPOCH = 1e9, 4e9
"""Seconds since 1970 of the years 2001 to 2096: counts of that size have no other unit."""
SERIAL_DAYS, MINUTE = ((32874.0, 69399.0), (726834.0, 763359.0)), 1.0 / 1440.0
"""Days of the years 1990 to 2089 since 1900 and since the year 0, as spreadsheets and MATLAB count them; and the
longest step between two of them: seconds of that size that rise by less than .7 ms are hardly ever met.
"""
COUNTED = ("s", "ms", "us", "ns")
"""Units in which programs count."""
POSSIBLE, USUAL = (1e-4, 100.0), (0.01, 10.0)
"""Shares of a rig's scored period within which samples lie that may be of it, and within which most do."""


def time_of(
    file: LogFile, free: list[LogColumn], given: Mapping[str, str], units: Mapping[str, str], period: float
) -> tuple[TimeColumn | str, list[LogColumn]]:
    """The times, or why there are none, and the columns that are left.

    given, units: the user's column and unit of "time", where they are there. period: of the samples [s], or 0.
    """
    stamped = {item.time for item in file.columns.values() if item.time}
    periods = [item for item in free if _says_period(file, item)]
    likely = [item for item in free if item.name in stamped or (item not in periods and _says_time(file, item))]
    left = [item for item in free if item not in likely and item not in periods and item.samples != 1]
    if len(likely) > 1:
        likely.sort(key=lambda item: (item.name not in stamped, not _rises(file, item), _place(item)))
    name = given.get("time") or (likely[0].name if likely else "")
    if not (name or period) and periods:
        period = _period_of(file, periods[0])
    if period:
        return TimeColumn(period=period), left
    if not name:
        rising = next((item.name for item in free if _rises(file, item)), "")
        return (
            f"{file.path}: no column is a time{f'; {rising} rises throughout' if rising else ''}; name it "
            f"(--column time={rising or 'COLUMN'}), or give the sampling time (--period)"
        ), left
    unit = units.get("time") or unit_of_times(file.columns[name]) or _unit_of_counts(file, name) or "s"
    return TimeColumn(column=name, unit=unit), left


def times_of_column(file: LogFile, name: str, time: TimeColumn, units: Mapping[str, str]) -> TimeColumn:
    """The times of a column: its own, if it has some and there are times at all, or else those of the file."""
    own = file.columns[name].time
    if not (own and time.column) or own == time.column:
        return time
    return replace(time, column=own, unit=units.get("time") or unit_of_times(file.columns[own]) or time.unit)


def own_times(file: LogFile) -> str:
    """The column of a file that has the times of the others; "" where there is none."""
    time, _ = time_of(file, list(file.columns.values()), {}, {}, 0.0)
    return time.column if isinstance(time, TimeColumn) else ""


def unit_of_times(column: LogColumn) -> str:
    """The unit of a column of times, as the file or the column's name says it; "" where neither does."""
    last = (words_of(column.name) or [""])[-1]
    return column.unit or (last if last in (*TIME_UNITS, "min", "h") else "")


def other_unit(file: LogFile, time: TimeColumn, *, scored: float) -> str:
    """Why the times of a file are not in a mapping's unit, or "": its name has another one, or they count the time
    since 1970 in another one; or nothing says a unit, and samples are as a rig has them in another one alone.

    scored: the rig's period [s]; 0 where the user said the unit, which values don't contradict.
    """
    if not time.column:
        return ""
    if own := unit_of_times(file.columns[time.column]):
        return f"{time.column} is in {own} by its own name" if seconds_of(own) not in (None, time.seconds) else ""
    if not scored:
        return ""
    if (since := _unit_of_counts(file, time.column)) in COUNTED:
        return f"{time.column} counts {since} since 1970" if seconds_of(since) != time.seconds else ""
    values = _finite(file, time.column)
    step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    if step <= 0.0 or POSSIBLE[0] < step * time.seconds / scored < POSSIBLE[1]:
        return ""
    periods = {unit: step * (seconds_of(unit) or 1.0) for unit in COUNTED}
    unit = next((unit for unit, period in periods.items() if USUAL[0] < period / scored < USUAL[1]), "")
    return f"{time.column} seems to be in {unit}, which is one sample in {periods[unit]:.3g} s" if unit else ""


def _says_time(file: LogFile, column: LogColumn) -> bool:
    """Whether a name says time and no unit denies it, or a unit says it and the values rise."""
    if column.unit and seconds_of(column.unit) is None:
        return False
    words = words_of(column.name)
    named = any(word in TIMES and (len(word) >= SHORTEST or {*words} <= {*TIMES}) for word in words)
    return named or (bool(column.unit) and _rises(file, column))


def period_words(name: str) -> set[str]:
    """The words of a name, or all of them together, that say sampling time or sampling rate."""
    words = words_of(name)
    return {*words, "".join(words)} & {*PERIODS, *RATES}


def _says_period(file: LogFile, column: LogColumn) -> bool:
    """Whether a column, or a single number, is the sampling time or rate of the rows."""
    found = period_words(column.name)
    denied = column.unit and column.unit != "Hz" and seconds_of(column.unit) is None
    return bool(found) and not denied and not (found & {*TIMES} and _rises(file, column))


def _period_of(file: LogFile, column: LogColumn) -> float:
    """The sampling time that a column says [s]; 0 where it says none."""
    value = float(np.nanmedian(file.read([column.name])[column.name]))
    if not value > 0.0:
        return 0.0
    return 1.0 / value if period_words(column.name) & {*RATES} else value * (seconds_of(column.unit or "s") or 1.0)


def _place(column: LogColumn) -> int:
    return min((TIMES.index(word) for word in words_of(column.name) if word in TIMES), default=len(TIMES))


def _finite(file: LogFile, name: str) -> Array:
    values = file.read([name])[name]
    return np.asarray(values[np.isfinite(values)])


def _rises(file: LogFile, column: LogColumn) -> bool:
    """Whether the values are times, and no sampling time that each row has."""
    values = _finite(file, column.name)
    return len(values) > 1 and bool(values[-1] > values[0] and (np.diff(values) >= 0.0).all())


def _unit_of_counts(file: LogFile, name: str) -> str:
    """The unit in which values count the time since 1970, or the days of spreadsheets or MATLAB; "" for others."""
    values = _finite(file, name)
    if len(values) < 2:
        return ""
    middle, step = float(np.median(values)), float(np.median(np.diff(values)))
    if any(low < middle < high for low, high in SERIAL_DAYS) and 0.0 < step < MINUTE:
        return "d"
    return next((unit for unit in COUNTED if _in_epoch(middle * (seconds_of(unit) or 1.0))), "")


def _in_epoch(seconds: float) -> bool:
    return EPOCH[0] < seconds < EPOCH[1]
