"""Moments: dates and times of day as people and programs write them, in seconds."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from hybrid_sysid_ros.support.arrays import Array

DAY, MIDNIGHT = 86400.0, 0.9
"""Seconds, and share of them by which times of day fall back at midnight."""
_YEAR, _SMALL = r"(?P<year>\d{4})", r"[-/.]"
_DATES = (
    rf"{_YEAR}{_SMALL}(?P<month>\d\d?){_SMALL}(?P<day>\d\d?)",
    rf"(?P<day>\d\d?){_SMALL}(?P<month>\d\d?){_SMALL}{_YEAR}",
    rf"(?P<month>\d\d?){_SMALL}(?P<day>\d\d?){_SMALL}{_YEAR}",
)
"""Year first, day first, month first."""
_CLOCK = (
    r"(?P<hour>\d\d?):(?P<minute>\d\d)(:(?P<second>\d\d([.,]\d+)?))?"
    r"( ?(?P<half>[AaPp])\.?[Mm]\.?)?( ?(?P<zone>Z|UTC|[-+]\d\d:?\d\d))?"
)
_FORMS = (*(rf"^{date}[T ]{_CLOCK}" for date in _DATES), rf"^{_CLOCK}$")
IS_MOMENT = re.compile("|".join(re.sub(r"\?P<\w+>", "?:", form) for form in _FORMS))
"""What begins as a date with a time of day, or is a time of day."""


def seconds_of_moments(texts: Any) -> Array:
    """Seconds since the first moment of a column of texts (polars), (rows,); NaN where there is none.

    Zones are taken into account, and times of day go on over midnight. Where 3/4 may be in March or in April, it is
    what makes the record shorter.
    """
    first = next((text for text in texts if text and IS_MOMENT.match(text)), "")
    found = [_read(texts, form) for form in _FORMS if re.match(form, first)]
    if not found:
        return np.full(len(texts), np.nan)
    most = max(int(np.isfinite(values).sum()) for values in found)
    whole = [values for values in found if np.isfinite(values).sum() == most]
    return min(whole, key=lambda values: float(np.ptp(values[np.isfinite(values)])))


def _read(texts: Any, form: str) -> Array:
    """The moments that are written in one form."""
    import polars

    parts = polars.DataFrame({"text": texts}).select(polars.col("text").str.extract_groups(form)).unnest("text")
    names = set(parts.columns)

    def number(name: str) -> polars.Expr:
        column = polars.col(name).str.replace(",", ".") if name in names else polars.lit(None)
        return column.cast(polars.Float64, strict=False).fill_null(0.0)

    date = polars.concat_str(["year", "month", "day"], separator="-").str.to_date("%Y-%m-%d", strict=False)
    days = date.to_physical().cast(polars.Float64) if "year" in names else polars.lit(0.0)
    hour = number("hour") % 12 + 12 * polars.col("half").is_in(["P", "p"])
    hours = polars.when(polars.col("half").is_null()).then(number("hour")).otherwise(hour)
    zone = polars.col("zone").str.replace(":", "")
    shift = zone.str.slice(1, 2).cast(polars.Float64, strict=False) * 60 + zone.str.slice(3, 2).cast(
        polars.Float64, strict=False
    )
    ahead = polars.when(zone.str.starts_with("-")).then(-shift).otherwise(shift).fill_null(0.0)
    rows = parts.select(
        days=polars.when(polars.col("hour").is_null()).then(None).otherwise(days),
        seconds=3600 * hours + 60 * (number("minute") - ahead) + number("second"),
    )
    day, second = (rows[name].cast(polars.Float64).to_numpy() for name in ("days", "seconds"))
    values = DAY * (day - (np.nanmin(day) if np.isfinite(day).any() else 0.0)) + second
    if "year" not in names:
        known = np.isfinite(values)
        values[known] += DAY * np.append(0.0, np.cumsum(np.diff(values[known]) < -MIDNIGHT * DAY))
    return np.asarray(values - (np.nanmin(values) if np.isfinite(values).any() else 0.0))
