"""Sentinel: the number by which a logger marks values that are missing, such as -999, 9999 or 32767."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.support.arrays import Array

FAR, NEAR = 5.0, 0.3
"""Distance from all other values, in their span, from which any number that comes again is no value, and from which one
of the usual numbers is none.
"""
DISTINCT, LARGEST_SHARE = 10, 0.5
"""Least number of other values, and largest share of the values that may be missing."""
FULL = frozenset((32767, 32768, 65535, 65536, 2147483647, 2147483648))
"""Ends of converters of 16 and 32 bits."""


def sentinel_of(values: Array) -> float | None:
    """The number in a signal (samples,) that stands for missing values; None where none does."""
    known = values[np.isfinite(values)]
    for value in (known.min(), known.max()) if len(known) else ():
        is_it = known == value
        rest = known[~is_it]
        if is_it.mean() > LARGEST_SHARE or len(np.unique(rest)) < DISTINCT:
            continue
        gap, reach = float(np.abs(rest - value).min()), float(np.ptp(rest))
        runs = int(np.count_nonzero(np.diff(is_it, prepend=False) & is_it))
        if gap > (NEAR if _is_usual(float(value)) else FAR) * reach and runs > 1:
            return float(value)
    return None


def _is_usual(value: float) -> bool:
    """Whether the digits are nines, or those of a converter's end."""
    digits = f"{abs(value):.12g}".replace(".", "").strip("0")
    return (len(digits) > 2 and {*digits} == {"9"}) or (digits.isdigit() and int(digits) in FULL)
