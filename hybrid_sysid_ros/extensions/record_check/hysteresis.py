"""Hysteresis: an output that answers otherwise on the way up than on the way down, as a valve that sticks makes it.

Integrals of the inputs, once and twice, first-order lags of them, of their squares and cubes, the decay of where the
record begins, and curves of the whole explain what they can of an output, and the same beside a play operator what they
can then. A play of width w follows its input only where that leaves the last value by more than w / 2 (Krasnosel'skii &
Pokrovskii 1989, Systems with Hysteresis).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from hybrid_sysid_ros.support.arrays import Array

WIDTHS = np.geomspace(0.02, 0.32, 7)
"""That are tried, in the signal's span."""
LAGS, MOST, ROWS, ROUNDS = 10, 3000, 8, 3
"""Lags of a bank, most samples by which it is judged, fewest for each column, and rounds in which what an output would
be without play is found.
"""
GAIN, LEFT, LEAST = 0.2, 0.1, 1e-5
"""Squared error that a play must leave, in that without it, and share of the output's variance: else it may be another
law, such as a rate limit, a dead zone or friction, of which a play explains between 70 and 80 % at most. LEAST: share
below which nothing is left to explain.
"""


@dataclass(frozen=True, kw_only=True)
class Hysteresis:
    """The play that explains an output best."""

    input: int | None
    """Which input has it; None: the output's sensor."""
    width: float
    """In that signal's unit."""
    left: float
    """Variance that it leaves of the output's."""


def hysteresis_of(inputs: Sequence[Array], output: Array) -> Hysteresis | None:
    """The play of an input or of the sensor, where one explains the output clearly better than none; None, too, where
    few samples would be explained by anything.
    """
    every = -(-len(output) // MOST)
    us, y = [_means(values, every) for values in inputs if np.ptp(values) > 0.0], _means(output, every)
    y = y - y.mean()
    moving = [k for k, values in enumerate(inputs) if np.ptp(values) > 0.0]
    once = [np.cumsum(_scaled(u)) for u in us]
    slow = [np.arange(len(y)), *once, *map(np.cumsum, once)]
    banks = [_bank(_scaled(u) ** power) for u in us for power in (1, 2, 3)]
    decays = _keeps(len(y)) ** np.arange(len(y))[:, None]  # a play, too, begins otherwise than it goes on
    columns = np.column_stack([np.ones(len(y)), *slow, decays, *banks])
    if len(y) < ROWS * columns.shape[1]:
        return None
    known = _directions(columns)
    straight = _scaled(known @ (known.T @ y))
    known = _directions(np.column_stack([known, straight**2, straight**3]))
    alone, whole = y - known @ (known.T @ y), float(y @ y)
    tried: list[tuple[int | None, float, Array]] = [
        (k, width, _bank(played(u, width))) for k, u in zip(moving, us, strict=True) for width in _widths(u)
    ]
    tried += [(None, width, more) for width in _widths(y) for more in _of_sensor(known, y, width)]
    found = [Hysteresis(input=k, width=width, left=_left(known, alone, more) / whole) for k, width, more in tried]
    best = min(found, key=lambda item: item.left)
    rest = float(alone @ alone) / whole
    return best if rest > LEAST and best.left < min(GAIN * rest, LEFT) else None


def _means(values: Array, every: int) -> Array:
    """Means of so many samples: of single ones, a noise that a feedback brings into an input would be another one."""
    return np.asarray(values[: len(values) // every * every].reshape(-1, every).mean(axis=1))


def _scaled(values: Array) -> Array:
    """From -1 to 1."""
    return np.asarray(2.0 * (values - values.min()) / max(float(np.ptp(values)), 1e-300) - 1.0)


def _widths(values: Array) -> list[float]:
    return (WIDTHS * float(np.ptp(values))).tolist()


def _directions(columns: Array) -> Array:
    """An orthonormal basis of what columns reach."""
    left, sizes, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return np.asarray(left[:, sizes > 1e-7 * sizes[0]])


def played(values: Array, width: float) -> Array:
    """What a play makes of a signal, (samples,)."""
    found, at = np.empty(len(values)), float(values[0])
    for k, value in enumerate(values.tolist()):
        at = min(max(at, value - 0.5 * width), value + 0.5 * width)
        found[k] = at
    return found


def _of_sensor(known: Array, y: Array, width: float) -> Iterator[Array]:
    """What a sensor's play adds to what the inputs explain, (samples, 1), better in each round."""
    explained = known @ (known.T @ y)
    for _ in range(ROUNDS):
        added = played(explained, width) - explained
        yield added[:, None]
        explained = known @ (known.T @ (y - added))


def _bank(values: Array) -> Array:
    """Lags of a signal from one sample to a tenth of the record, and the signal, (samples, LAGS + 1)."""
    moved = values - values[0]
    lagged = (lfilter([1.0 - keep], [1.0, -keep], moved) for keep in _keeps(len(values)).tolist())
    return np.column_stack([moved, *lagged])


def _keeps(samples: int) -> Array:
    """What each lag keeps from a sample to the next, (LAGS,)."""
    return np.asarray(np.exp(-1.0 / np.geomspace(1.0, 0.1 * samples, LAGS)))


def _left(known: Array, alone: Array, more: Array) -> float:
    """Sum of squares that is left where more columns explain what the known ones leave."""
    more = more - known @ (known.T @ more)
    error = alone - more @ np.linalg.lstsq(more, alone, rcond=1e-8)[0]
    return float(error @ error)
