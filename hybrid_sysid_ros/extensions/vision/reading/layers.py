"""Layers of a picture: what stands, and what a joint turns before it; kept as a folder."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built

Plane = NDArray[np.float32]
"""Numbers of pixels or texels (rows, columns)."""

KIND, VERSION = "layers", 1
DIRECTIONS, ALIKE = 720, 0.6  # around the pivot, and correlation of a sprite with itself, turned, that looks alike
NAMES = ("background", "alpha", "texture")
WHITE, SATURATED = 255.0, 250.0
"""Counts that a pixel shows at most, and from which on it may have been so, as a codec rings."""


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Where the layers lie and how a picture was taken; lengths in pixels, x to the right, y down."""

    rig: str
    joint: str
    pivot_x: float
    pivot_y: float
    first_u: float
    """Of the sprite's first texel, from the pivot; texels are a pixel apart."""
    first_v: float
    low: float
    """Lowest and highest angle that was seen [rad],"""
    high: float
    noise: float
    """of a pixel, rms [counts]."""
    readout: float
    """From the first row to one behind the last [s]."""
    scale: float = 1.0
    """The joint's position is scale (angle - zero) [rad]."""
    zero: float = 0.0
    scale_deviation: float = 0.0
    """Standard deviation of the scale, by what the pivot may be off, where no sensor told it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PictureLayers:
    """I = gain [B (1 - a) + T] + noise in counts; a and T at u = dx c + dy s, v = -dx s + dy c about the pivot, where
    (c, s) = (cos angle, -sin angle): counter-clockwise angles, y down.
    """

    geometry: Geometry
    background: Plane
    """B (rows, columns)."""
    alpha: Plane
    """a (texels): how far the sprite covers what is behind it, from 0 to 1."""
    texture: Plane
    """T (texels), premultiplied."""

    @property
    def pivot(self) -> tuple[float, float]:
        return self.geometry.pivot_x, self.geometry.pivot_y

    @property
    def first(self) -> tuple[float, float]:
        """Where the sprite's first texel is, from the pivot."""
        return self.geometry.first_u, self.geometry.first_v

    @property
    def reach(self) -> float:
        """Largest distance of a texel that covers something from the pivot."""
        rows, columns = np.nonzero(self.alpha > 0.1)
        if not rows.size:
            return 1.0
        return float(np.hypot(columns + self.geometry.first_u, rows + self.geometry.first_v).max())

    @property
    def full_turn(self) -> bool:
        """Whether angles go round."""
        return self.geometry.high - self.geometry.low >= 2.0 * math.pi

    @cached_property
    def period(self) -> float:
        """Turn after which the sprite looks alike [rad], as a wheel of five spokes does after a fifth of one; 0 where
        angles do not go round.
        """
        if not self.full_turn:
            return 0.0
        radii, directions = np.linspace(0.15, 1.0, 24)[:, None] * self.reach, np.arange(DIRECTIONS) / DIRECTIONS
        u = radii * np.cos(2.0 * math.pi * directions) - self.first[0]
        v = radii * np.sin(2.0 * math.pi * directions) - self.first[1]
        shown = interpolated(self.texture, u, v) - interpolated(self.alpha, u, v) * float(self.background.mean())
        spectrum = np.abs(np.fft.rfft(shown, axis=1)) ** 2
        spectrum[:, 0] = 0.0
        alike = np.fft.irfft((radii * spectrum).sum(axis=0), n=DIRECTIONS)
        parts = [n for n in range(2, 13) if alike[round(DIRECTIONS / n)] > ALIKE * alike[0]]
        return 2.0 * math.pi / max(parts, default=1)

    def row_time(self, row: float) -> float:
        """Middle of a row's exposure after that of the picture's middle row [s]."""
        rows = self.background.shape[0]
        return (row - (rows - 1) / 2) * self.geometry.readout / rows

    def position(self, angle: float) -> float:
        """Of the joint [rad], where the sprite is at an angle."""
        return self.geometry.scale * (angle - self.geometry.zero)

    def angle(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of the sprite [rad], where the joint is at positions of any shape [rad]."""
        return position / self.geometry.scale + self.geometry.zero

    def drawn(self, angle: float) -> Plane:
        """The picture that the layers make at an angle, its light that of the mean (rows, columns) [counts]."""
        rows, columns = self.background.shape
        dy, dx = np.mgrid[:rows, :columns].astype(np.float64)
        dx, dy = dx - self.pivot[0], dy - self.pivot[1]
        c, s = math.cos(angle), -math.sin(angle)
        u, v = dx * c + dy * s - self.first[0], -dx * s + dy * c - self.first[1]
        alpha, texture = (interpolated(plane, u, v) for plane in (self.alpha, self.texture))
        return np.asarray(self.background * (1.0 - alpha) + texture, dtype=np.float32)

    def save(self, path: Path | str) -> None:
        """Write the folder; older layers there are replaced. Raises UserError where that can't be."""
        planes: Any = {name: getattr(self, name).astype(np.float16) for name in NAMES}
        storage.save(path, kind=KIND, version=VERSION, content={"geometry": vars(self.geometry)}, arrays=planes)

    @classmethod
    def load(cls, path: Path | str) -> PictureLayers:
        """Read a folder. Raises UserError where it holds no layers."""
        content, planes = storage.load(path, kind=KIND, version=VERSION)
        geometry = built(Geometry, content.get("geometry"), f"{path}: geometry")
        shapes = [planes[name].shape if name in planes else () for name in NAMES]
        if any(len(shape) != 2 for shape in shapes) or shapes[1] != shapes[2]:
            raise UserError(f"{path}: its planes do not fit together; learn them again (hybrid-sysid video --layers)")
        return cls(geometry=geometry, **{name: planes[name].astype(np.float32) for name in NAMES})


def interpolated(plane: Plane, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """A plane between its points, by columns x and rows y of any shape; 0 outside."""
    rows, columns = plane.shape
    k, i = np.floor(x).astype(int), np.floor(y).astype(int)
    inside = (k >= 0) & (i >= 0) & (k < columns - 1) & (i < rows - 1)
    k, i = np.where(inside, k, 0), np.where(inside, i, 0)
    right, down = x - k, y - i
    top = (1.0 - right) * plane[i, k] + right * plane[i, k + 1]
    bottom = (1.0 - right) * plane[i + 1, k] + right * plane[i + 1, k + 1]
    return np.where(inside, (1.0 - down) * top + down * bottom, 0.0)
