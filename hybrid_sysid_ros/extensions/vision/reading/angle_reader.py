"""Angle reader: pictures in, the joint's angle with its standard deviation out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.reading.alignment import align_freely, align_from, read_angle
from hybrid_sysid_ros.extensions.vision.reading.layers import SATURATED, PictureLayers, interpolated
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

POINTS, FEW = 4000, 240  # texels that an alignment looks at, and those of a scan
MARGIN = math.radians(3.0)  # by which a scan goes beyond what was seen
SCAN_STEP = 1.5 / 640  # widths of the picture that the sprite's end moves from one scanned angle to the next
STILL = 33  # pixels of a row that tell the light
WITNESSES = 0.3  # of the width: still pixels by which a row tells its light, twice as broad as one who walks by
COVERED = 0.02  # a, above which a texel hides or colours what is behind it
EXPLAINED = 0.35  # share of the points that the layers must explain
LIT = 0.05  # share of the light under which the layers were learned, below which noise may pass for a sprite
SCENERY = 5000  # pixels that the joint never comes over, by which a moved camera is known
STANDS = 0.97
"""Correlation of what stands in pictures with the background, below which the camera was moved, by four of 640 pixels
or a degree of roll, or they are of something else; noise of 8 counts leaves .987 in a single one."""
EVEN = 2.0  # counts: what stands differs by less, and tells nothing
DARK = 8.0  # counts: a background below it tells nothing of the light; nor does one that is white


@dataclass(frozen=True, kw_only=True)
class AngleReading:
    """What a picture says."""

    angle: float
    """Of the sprite [rad]; NaN where it was not found."""
    deviation: float
    """Standard deviation of the angle [rad]."""
    row: float
    """The row at whose time the angle was that: the mean of the pixels by what they tell of it."""
    difference: float
    """Between picture and layers, standard deviation of most pixels [counts]: large where the joint is not there."""
    explained: float
    """Share of the pixels that the layers explain, from 0 to 1."""
    per_count: float = math.nan
    """By how much the angle is another one where each edge is off by a count, all to one side [rad/count]."""

    @property
    def found(self) -> bool:
        return math.isfinite(self.angle)


@dataclass(frozen=True, kw_only=True)
class FreeReading:
    """What a picture says where the sprite may lie beside its pivot; all are NaN where that is unknown."""

    angle: float
    """[rad]"""
    x: float
    """Beside the pivot [pixels]."""
    y: float
    deviation: float
    """Standard deviation of the angle [rad]."""
    beside: float
    """Standard deviation of the place [pixels]."""
    row: float


class AngleReader:
    """Aligns layers with pictures; no picture knows of another one, so that none is lost for the sake of the last."""

    def __init__(self, layers: PictureLayers) -> None:
        """Chooses the texels that tell most of the angle."""
        self.layers = layers
        self._planes = (layers.background, layers.alpha, layers.texture, layers.first, layers.pivot)
        self._reach = layers.reach
        self.angles = self._angles()
        self.swept = self._swept()
        """Pixels (rows, columns) that the sprite comes over, with a pixel around."""
        self._columns = self._still(self.swept)
        still = np.flatnonzero(~self.swept)
        self._scenery = np.random.default_rng(0).choice(still, min(SCENERY, len(still)), replace=False)
        self.points = self._informative()
        """Texels (points, 2) that an alignment looks at, from the pivot [pixels]."""
        stride = max(len(self.points) // FEW, 1)
        self._few = np.ascontiguousarray(self.points[::stride])
        self._gains, self._out = np.ones(layers.background.shape[0]), np.empty(7)

    def read(self, picture: NDArray[np.uint8]) -> AngleReading:
        """The angle of a picture (rows, columns).

        Raises UserError for a picture of another size than the layers'.
        """
        if picture.shape != self.layers.background.shape:
            (rows, columns), (own_rows, own_columns) = picture.shape, self.layers.background.shape
            raise UserError(
                f"a picture of {columns}x{rows} pixels: the layers were learned at {own_columns}x{own_rows}; take one "
                "of that size, or learn layers of this one"
            )
        out = self._out
        read_angle(
            picture, *self._planes, self._columns, self.points, self._few, self.angles, self._reach, self._gains, out
        )  # fmt: skip
        return self._reading(self._gains)

    def read_near(self, picture: NDArray[np.uint8], angle: float, gains: Array) -> AngleReading:
        """The same without a scan, from a near angle on, under gains (rows,) of the light."""
        align_from(picture, *self._planes, gains, self.points, angle, self._reach, self._out)
        return self._reading(gains)

    def read_freely(self, picture: NDArray[np.uint8], angle: float, gains: Array) -> FreeReading:
        """Angle and place together, from a near angle on, under gains (rows,) of the light: what a camera that shakes,
        or a pivot that is off, does to the place does nothing to this angle.
        """
        out = np.full(7, np.nan)
        align_freely(picture, *self._planes, gains, self.points, angle, self._reach, out)
        turned, x, y, variance, along, down, row = out.tolist()
        return FreeReading(
            angle=turned, x=x, y=y, deviation=math.sqrt(variance), beside=math.sqrt(along + down), row=row
        )

    def scenery(self, picture: NDArray[np.uint8]) -> Array:
        """What stands in a picture of the layers' size, at some pixels (pixels,); their mean is 1."""
        shown = picture.ravel()[self._scenery].astype(np.float64)
        return np.asarray(shown / max(float(shown.mean()), 1e-9))

    def standing(self, sceneries: Sequence[Array]) -> float:
        """Correlation of what stands in pictures with the background, beside what their noise leaves of it; of their
        median, so that somebody who comes by does not count. It is 1 where the background is so even that nothing is
        told by it.
        """
        shown, standing = np.median(sceneries, axis=0), self.layers.background.ravel()[self._scenery]
        if not np.ptp(shown):
            return 0.0
        noise, contrast = self.layers.geometry.noise, float(standing.std())
        if contrast < EVEN + noise:
            return 1.0
        left = contrast / math.hypot(contrast, noise * math.sqrt(math.pi / 2.0 / len(sceneries)))
        return min(float(np.corrcoef(shown, standing)[0, 1]) / left, 1.0)

    @property
    def gains(self) -> Array:
        """The light on the rows (rows,) of the picture that was read last."""
        return self._gains

    @property
    def lit(self) -> bool:
        """Whether there was light in the picture that was read last."""
        return self._lit(self._gains)

    def _lit(self, gains: Array) -> bool:
        return bool(np.median(gains) >= LIT)

    def _reading(self, gains: Array) -> AngleReading:
        angle, variance, _, row, explained, difference, per_count = self._out.tolist()
        if not (explained >= EXPLAINED and variance >= 0.0 and self._lit(gains)):
            angle, variance, row = math.nan, math.inf, math.nan
        return AngleReading(
            angle=angle, deviation=math.sqrt(variance), row=row, difference=difference, explained=max(explained, 0.0),
            per_count=per_count,
        )  # fmt: skip

    def _angles(self) -> Array:
        geometry, step = self.layers.geometry, SCAN_STEP * self.layers.background.shape[1] / self._reach
        if self.layers.full_turn:
            count = math.ceil(2.0 * math.pi / step)
            return np.asarray(geometry.low + 2.0 * math.pi * np.arange(count) / count)
        low, high = geometry.low - MARGIN, geometry.high + MARGIN
        return np.linspace(low, high, max(math.ceil((high - low) / step), 3))

    def _swept(self) -> NDArray[np.bool_]:
        layers = self.layers
        rows, columns = layers.background.shape
        found = np.zeros((rows, columns), dtype=bool)
        down, across = np.nonzero(layers.alpha > COVERED)
        u, v = across + layers.first[0], down + layers.first[1]
        step = 0.7 / self._reach
        count = max(math.ceil((self.angles[-1] - self.angles[0]) / step), 2)
        for angle in np.linspace(self.angles[0], self.angles[-1], count):
            c, s = math.cos(angle), -math.sin(angle)
            x = np.rint(layers.pivot[0] + u * c - v * s).astype(int)
            y = np.rint(layers.pivot[1] + u * s + v * c).astype(int)
            inside = (x >= 0) & (y >= 0) & (x < columns) & (y < rows)
            found[y[inside], x[inside]] = True
        grown = found.copy()
        for axis in (0, 1):
            for shift in (-1, 1):
                grown |= np.roll(found, shift, axis)
        return grown

    def _still(self, swept: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Columns (rows, pixels) of some pixels of each row that the sprite never comes over, -1 for none; a row where
        these are so few that one who walks by may hide most of them has none.
        """
        background = self.layers.background
        good = ~swept & (background > DARK) & (background < SATURATED)
        counts = good.sum(axis=1)
        enough = min(WITNESSES * swept.shape[1], counts.max())
        columns: NDArray[np.int32] = np.full((len(swept), STILL), -1, dtype=np.int32)
        for y in np.flatnonzero((counts >= enough) & (counts > 0)):
            places = np.flatnonzero(good[y])
            chosen = places[np.linspace(0, len(places) - 1, min(STILL, len(places))).astype(int)]
            columns[y, : len(chosen)] = chosen
        return columns

    def _informative(self) -> NDArray[np.float32]:
        """Texels (points, 2) where the picture changes most with the angle, along the sprite."""
        layers, (rows, columns) = self.layers, self.layers.alpha.shape
        v, u = np.mgrid[:rows, :columns].astype(np.float64)
        u, v = u + layers.first[0], v + layers.first[1]
        information = np.zeros(layers.alpha.shape)
        looks = np.linspace(layers.geometry.low, layers.geometry.high, 5)
        for angle in looks:
            c, s = math.cos(angle), -math.sin(angle)
            x, y = layers.pivot[0] + u * c - v * s, layers.pivot[1] + u * s + v * c
            shown = interpolated(layers.background, x, y) * (1.0 - layers.alpha) + layers.texture
            edge = (x < 1) | (y < 1) | (x > layers.background.shape[1] - 2) | (y > layers.background.shape[0] - 2)
            by_v, by_u = np.gradient(shown)
            information += np.where(edge, 0.0, (by_v * u - by_u * v) ** 2)
        covered = layers.alpha > COVERED
        near = covered.copy()
        for axis in (0, 1):
            for shift in (-1, 1):
                near |= np.roll(covered, shift, axis)
        order = np.argsort(np.where(near, information, 0.0), axis=None)[::-1]
        sums = np.cumsum(information.ravel()[order])
        enough = int(np.searchsorted(sums, 0.97 * sums[-1])) + 1
        chosen = np.sort(order[:enough])
        chosen = chosen[:: max(math.ceil(len(chosen) / POINTS), 1)]
        mixed = np.random.default_rng(0).permutation(chosen)  # so that every stride of them is spread out
        return np.column_stack([u.ravel()[mixed], v.ravel()[mixed]]).astype(np.float32)
