"""Imager: a simulated camera in front of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.exposure import expose, instants_of
from hybrid_sysid_ros.extensions.vision.camera.painting import Grid, grid_around, painted
from hybrid_sysid_ros.extensions.vision.scene import Scene
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

Picture = NDArray[np.uint8]
"""Grey (rows, columns)."""

FINE = 2
"""Texels of a painted sprite in a pixel."""
NOISE = 1 << 18  # numbers in the ring of noise
SLOW = 0.11  # Hz, of the changes of the light


@dataclass(frozen=True, kw_only=True)
class Camera:
    """What a camera does to a scene. Raises UserError where that can't be."""

    width: int = 640
    height: int = 360
    rate: float = 30.0
    """Pictures a second."""
    exposure: float = 0.008
    """Of a row [s]."""
    readout: float = 0.016
    """From the first row to one behind the last [s]: the rolling shutter."""
    noise: float = 2.5
    """White, rms, in counts of 255."""
    gain: float = 1.0
    """Of the light: below 1 it is dim."""
    light: float = 0.0
    """By which the light comes and goes slowly, +-, as a share of it."""
    flicker: float = 0.0
    """Amplitude of the mains in the light, as a share of it, before the exposure averages it."""
    flicker_hertz: float = 120.0

    def __post_init__(self) -> None:
        if min(self.width, self.height) < 16:
            raise UserError(f"a picture of {self.width}x{self.height} pixels is too small: 16x16 at least")
        if not (self.rate > 0.0 and self.exposure > 0.0 and self.readout >= 0.0):
            raise UserError("a camera needs a rate and an exposure above 0, and a readout that is not below it")
        if max(self.exposure, self.readout) * self.rate > 1.0:
            raise UserError(f"exposure and readout must be shorter than a period, {1.0 / self.rate:g} s")

    def row_times(self) -> Array:
        """Middle of each row's exposure (rows,) after that of the picture's middle row [s]."""
        rows = np.arange(self.height) - (self.height - 1) / 2
        return np.asarray(rows * self.readout / self.height)


class Imager:
    """Takes pictures of a scene whose joint moves."""

    def __init__(self, scene: Scene, camera: Camera, *, seed: int = 0) -> None:
        """Paints. seed: of the noise."""
        self.scene, self.camera = scene, camera
        width, pixel = camera.width, 1.0 / camera.width
        whole = Grid(start=(pixel / 2, pixel / 2), pitch=pixel, shape=(camera.height, width))
        alpha, texture = painted(scene.background, whole)
        self._background = scene.shade * (1.0 - alpha) + texture
        grid = grid_around(scene.sprite, pixel / FINE)
        self._alpha, self._texture = painted(scene.sprite, grid)
        self._place = (grid.start[0] * width, grid.start[1] * width, 1.0 / FINE)
        self._pivot = (scene.pivot[0] * width - 0.5, scene.pivot[1] * width - 0.5)
        self._reach = max(patch.reach for patch in scene.sprite) * width
        self._lamp = np.zeros(whole.shape)
        if scene.lamp is not None:
            x, y = whole.axes()
            far = np.hypot(x - scene.lamp.at[0], y - scene.lamp.at[1])
            self._lamp = scene.lamp.shade * np.clip(0.5 + (scene.lamp.radius - far) / pixel, 0.0, 1.0)
        self._random = np.random.default_rng(seed)
        self._noise = (camera.noise * self._random.standard_normal(NOISE + width)).astype(np.float32)

    @property
    def lead(self) -> float:
        """How long [s] before a picture's stamp its first row begins; so long behind it the last one ends."""
        return (self.camera.readout + self.camera.exposure) / 2

    def take(self, time: float, times: Array, angles: Array, *, onset: float = math.inf) -> Picture:
        """The picture whose middle row is exposed about ``time`` [s], under a motion: angles [rad] (n,) at times [s]
        (n,) that rise; the lamp is lit from ``onset`` on.
        """
        camera = self.camera
        middles = time + camera.row_times()
        begins = middles - camera.exposure / 2
        instants = instants_of(times, angles, begins, camera.exposure, self._reach)
        lit = np.clip((begins + camera.exposure - onset) / camera.exposure, 0.0, 1.0)
        offsets = self._random.integers(0, NOISE, camera.height)
        picture = np.empty((camera.height, camera.width), dtype=np.uint8)
        expose(
            self._background, self._alpha, self._texture, self._place, self._pivot, self.scene.roll, times, angles,
            begins, camera.exposure, instants, self.gains(middles), self._lamp, lit, self._noise, offsets, picture,
        )  # fmt: skip
        return picture

    def mean_angle(self, time: float, times: Array, angles: Array, *, row: float) -> float:
        """The truth of a picture: the joint's mean [rad] over the exposure of a row."""
        begin = time + (row - (self.camera.height - 1) / 2) * self.camera.readout / self.camera.height
        inside = begin + self.camera.exposure * ((np.arange(50) + 0.5) / 50 - 0.5)
        return float(np.interp(inside, times, angles).mean())

    def gains(self, middles: Array) -> Array:
        """The light (rows,) while rows are exposed, about their middles [s]."""
        camera = self.camera
        slow = 1.0 + camera.light * np.sin(2.0 * np.pi * SLOW * middles)
        averaged = camera.flicker * float(np.sinc(camera.flicker_hertz * camera.exposure))
        return np.asarray(camera.gain * slow * (1.0 + averaged * np.sin(2.0 * np.pi * camera.flicker_hertz * middles)))
