"""Painting: patches as what pixels see of them, each the mean of its square."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.extensions.vision.scene import Patch
from hybrid_sysid_ros.support.arrays import Array

SEED = 7
"""Of the greys of patches that vary."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """Squares in a row: their middles are at ``start + k pitch``, in widths of the picture."""

    start: tuple[float, float]
    pitch: float
    shape: tuple[int, int]
    """Rows, columns."""

    def axes(self) -> tuple[Array, Array]:
        """Middles along x (1, columns) and along y (rows, 1)."""
        rows, columns = self.shape
        x: Array = self.start[0] + self.pitch * np.arange(columns, dtype=np.float64)
        y: Array = self.start[1] + self.pitch * np.arange(rows, dtype=np.float64)
        return x[None, :], y[:, None]


def grid_around(patches: Sequence[Patch], pitch: float) -> Grid:
    """The squares that a sprite's patches reach, with one more on each side."""
    turned = any(angle for patch in patches for angle in patch.turned)
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for patch in patches:
        half = np.array(patch.box) / 2 if patch.box else np.full(2, patch.disc)
        first = np.array(patch.at)
        last = first + (np.array(patch.times) - 1) * np.array(patch.pitch)
        if turned:
            half, first, last = np.full(2, patch.reach), np.zeros(2), np.zeros(2)
        low = np.minimum(low, np.minimum(first, last) - half)
        high = np.maximum(high, np.maximum(first, last) + half)
    count = np.ceil((high - low) / pitch).astype(int) + 3
    middle = (low + high) / 2
    start = middle - pitch * (count - 1) / 2
    return Grid(start=(float(start[0]), float(start[1])), pitch=pitch, shape=(int(count[1]), int(count[0])))


def painted(patches: Sequence[Patch], grid: Grid) -> tuple[Array, Array]:
    """Cover a and grey T, premultiplied by it, of patches one over the other: both (rows, columns), from 0 to 1."""
    alpha, texture = np.zeros(grid.shape), np.zeros(grid.shape)
    random = np.random.default_rng(SEED)
    x, y = grid.axes()
    for patch in patches:
        for (left, up), turn in _places(patch):
            shade = float(np.clip(patch.shade + patch.vary * random.uniform(-1, 1), 0.0, 1.0))
            reach = patch.disc or math.hypot(*patch.box) / 2
            middle = (math.cos(turn) * left - math.sin(turn) * up, math.sin(turn) * left + math.cos(turn) * up)
            rows = _window(y[:, 0], middle[1], reach + grid.pitch)
            columns = _window(x[0], middle[0], reach + grid.pitch)
            cover = _cover(patch, x[:, columns], y[rows], (left, up), turn, grid.pitch)
            for layer, value in ((texture, shade), (alpha, 1.0)):
                layer[rows, columns] += cover * (value - layer[rows, columns])
    return alpha, texture


def _places(patch: Patch) -> Iterator[tuple[tuple[float, float], float]]:
    for turn in patch.turned:
        for row in range(patch.times[1]):
            for column in range(patch.times[0]):
                x = patch.at[0] + column * patch.pitch[0] + (row % 2) * patch.stagger
                yield (x, patch.at[1] + row * patch.pitch[1]), turn


def _window(middles: Array, at: float, reach: float) -> slice:
    first, last = np.searchsorted(middles, [at - reach, at + reach])
    return slice(int(first), int(last))


def _cover(patch: Patch, x: Array, y: Array, at: tuple[float, float], turn: float, pitch: float) -> Array:
    """Share of each square that a patch covers: exact for a box that is not turned."""
    cos, sin = math.cos(turn), math.sin(turn)
    u, v = x * cos + y * sin - at[0], -x * sin + y * cos - at[1]
    if patch.disc:
        return np.asarray(np.clip(0.5 + (patch.disc - np.hypot(u, v)) / pitch, 0.0, 1.0))
    return _overlap(u, patch.box[0] / 2, pitch) * _overlap(v, patch.box[1] / 2, pitch)


def _overlap(x: Array, half: float, pitch: float) -> Array:
    """Share of an interval of length ``pitch`` about x that lies within +-half."""
    inside = np.minimum(x + pitch / 2, half) - np.maximum(x - pitch / 2, -half)
    return np.asarray(np.maximum(inside, 0.0) / pitch)
