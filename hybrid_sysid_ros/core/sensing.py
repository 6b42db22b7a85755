"""Sensing: what sensors make of a run's outputs where a model knows them: readings that are late, and means.

    r(t) = 1 / w  integral of y from t - d - w to t - d,    r(t) = y(t - d) for w = 0

with y joined by lines between the steps. Before its beginning a run goes on along its first step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.support.arrays import Array

SHORTEST = 1e-6
"""Window in steps below which a reading is instantaneous."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensing:
    """The sensors that a system knows; p outputs."""

    names: tuple[str, ...]
    """Parameters of sensors, which are fitted over whole records only: within a record states come from readings."""
    delays: Array
    """Age of each reading [s], (p,)."""
    windows: Array
    """Time over which it is a mean [s], (p,)."""
    known: NDArray[np.bool_]
    """Outputs whose delay and window the system knows, (p,); those of others are 0."""
    moved_by: tuple[tuple[str, str], ...]
    """Names of the parameters of delay and window of each output, "" where they are no parameters."""
    spreads: Array
    """Prior deviations of gain, offset, delay and window of each output, (p, 4)."""

    @property
    def common_lag(self) -> float:
        """Age that all readings share [s]. A loop that takes readings as they come has it as a delay of its inputs."""
        return float(np.min(np.where(self.known, self.delays + 0.5 * self.windows, 0.0)))

    @property
    def late(self) -> bool:
        """Whether a reading is more than the output at its moment."""
        return bool(np.any(self.known))

    def readings(self, fine: Array, starts: NDArray[np.int64], every: int, step: float) -> Array:
        """Readings (samples, p, ...) of runs that ``fine`` (steps, p, ...) has at each step; see :func:`finest`."""
        total = int((starts[:, 2] + starts[:, 3]).max())
        found = np.empty((total, *fine.shape[1:]))
        for (_, _, samples, row), (_, _, steps, begin) in zip(starts, finest(starts, every), strict=True):
            for k in range(fine.shape[1]):
                run, lag, window = fine[begin : begin + steps, k], self.delays[k] / step, self.windows[k] / step
                found[row : row + samples, k] = _read(run, lag, window, every, samples)[0]
        return found

    def moves(self, fine: Array, starts: NDArray[np.int64], every: int, step: float) -> dict[str, tuple[int, Array]]:
        """By the name of a delay or window, its output and the derivatives of its readings (samples,) by it [1/s]."""
        total, found = int((starts[:, 2] + starts[:, 3]).max()), dict[str, tuple[int, Array]]()
        for k, names in enumerate(self.moved_by):
            slopes = np.zeros((2, total))
            for (_, _, samples, row), (_, _, steps, begin) in zip(starts, finest(starts, every), strict=True):
                run, lag, window = fine[begin : begin + steps, k], self.delays[k] / step, self.windows[k] / step
                slopes[:, row : row + samples] = _read(run, lag, window, every, samples)[1:]
            found |= {name: (k, slopes[i] / step) for i, name in enumerate(names) if name}
        return found

    def start_deviations(
        self, known: Mapping[int, tuple[int, bool]], outputs: Array, rates: Array, period: float
    ) -> dict[int, float]:
        """By state that a record shows, how far its sensors leave its first value open, as a standard deviation.

        known: states by index, see :class:`~.record_map.RecordMap`; outputs, rates (samples, p), every ``period`` [s].
        """
        sizes = [np.sqrt(np.mean(values**2, axis=0)) for values in (outputs, rates, np.gradient(rates, period, axis=0))]
        gain, offset, delay, window = self.spreads.T
        late, lag = np.hypot(delay, 0.5 * window), self.delays + 0.5 * self.windows
        level = np.sqrt((gain * sizes[0]) ** 2 + offset**2 + (late * sizes[1]) ** 2 + (0.5 * lag**2 * sizes[2]) ** 2)
        slope = np.sqrt((gain * sizes[1]) ** 2 + ((late + lag) * sizes[2]) ** 2)
        return {state: float((slope if rate else level)[column]) for state, (column, rate) in known.items()}


def finest(starts: NDArray[np.int64], every: int) -> NDArray[np.int64]:
    """The rollouts of ``starts`` with a row for each step, in rows of their own."""
    found = starts.copy()
    found[:, 2] = (starts[:, 2] - 1) * every + 1
    found[:, 3] = np.cumsum([0, *found[:-1, 2]])
    return found


def _read(run: Array, lag: float, window: float, every: int, samples: int) -> tuple[Array, Array, Array]:
    """Readings (samples, ...) of a run (steps, ...), and their derivatives by lag and window, all in steps."""
    more = int(np.ceil(lag + window)) + 1
    slope = run[1] - run[0] if len(run) > 1 else np.zeros_like(run[0])
    back = np.arange(more, 0, -1.0).reshape(-1, *([1] * slope.ndim))
    run = np.concatenate([run[0] - back * slope, run])
    until = np.asarray(more + every * np.arange(samples) - lag, dtype=np.float64)

    def place(at: Array) -> tuple[NDArray[np.int64], Array]:
        first = np.clip(np.floor(at).astype(np.int64), 0, len(run) - 2)
        return first, (at - first).reshape(-1, *([1] * slope.ndim))

    first, part = place(until)
    rate = run[first + 1] - run[first]
    ends = run[first] + part * rate
    if window < SHORTEST:
        return ends, -rate, -0.5 * rate
    sums = np.concatenate([np.zeros_like(run[:1]), np.cumsum(0.5 * (run[1:] + run[:-1]), axis=0)])
    total = sums[first] + part * (run[first] + 0.5 * part * rate)
    first, part = place(np.asarray(until - window, dtype=np.float64))
    rate = run[first + 1] - run[first]
    begins = run[first] + part * rate
    mean = (total - sums[first] - part * (run[first] + 0.5 * part * rate)) / window
    return mean, (begins - ends) / window, (begins - mean) / window
