"""Renderers: what draws the picture of a motion."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hybrid_sysid_ros.extensions.vision.camera.exposure import expose, instants_of
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.support.arrays import Array


class Renderer(Protocol):
    """Draws pictures of a joint's motion; an ``Imager`` is one, too."""

    def take(self, time: float, times: Array, angles: Array) -> Picture:
        """The picture (rows, columns) whose middle row is exposed about ``time`` [s], under a motion: positions [rad]
        (n,) of the joint at times [s] (n,) that rise.
        """
        ...


class LayerRenderer(Renderer):
    """Draws learned layers as the camera that they were learned from would see them move, without its noise."""

    def __init__(self, layers: PictureLayers, *, exposure: float) -> None:
        """exposure: of a row [s]."""
        self.layers, self.exposure = layers, exposure
        rows, columns = layers.background.shape
        self._planes = tuple(
            plane.astype(np.float64) / 255.0 for plane in (layers.background, layers.alpha * 255.0, layers.texture)
        )
        self._rows = np.array([layers.row_time(row) for row in range(rows)])
        self._dark, self._lit, self._bright = np.zeros((rows, columns)), np.zeros(rows), np.ones(rows)
        self._noise, self._offsets = np.zeros(columns, dtype=np.float32), np.zeros(rows, dtype=np.int64)
        self._place = (*layers.first, 1.0)

    def take(self, time: float, times: Array, angles: Array) -> Picture:
        turned = self.layers.angle(angles)
        begins = time + self._rows - self.exposure / 2
        instants = instants_of(times, turned, begins, self.exposure, self.layers.reach)
        picture = np.empty(self._dark.shape, dtype=np.uint8)
        expose(
            *self._planes, self._place, self.layers.pivot, 0.0, times, turned, begins, self.exposure, instants,
            self._bright, self._dark, self._lit, self._noise, self._offsets, picture,
        )  # fmt: skip
        return picture
