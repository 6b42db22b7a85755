"""Light across: how the light leans from side to side in the pictures of a film, as where a lamp beside it dims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import theilslopes

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.camera_motion import SAMPLED, TimedPictures
from hybrid_sysid_ros.extensions.vision.reading.layers import SATURATED
from hybrid_sysid_ros.support.arrays import Array

STRIPS, COLUMNS = 16, 160  # upright, that tell the light, and pixels of a row that are looked at
DARK = 20.0  # counts, below which a quotient is mostly noise
LEAST = 0.02  # of the light, rms: less moves no edge
CERTAIN = 2.5  # deviations of a measured lean, as of a camera's motion


@dataclass(frozen=True, kw_only=True, eq=False)
class LightAcross:
    """Light gain (1 + lean x) of each picture, x from -1 at its left to 1 at its right; the gain of its rows is found
    where its angle is.
    """

    leans: Array
    """(pictures,)"""

    @property
    def size(self) -> float:
        """Of the leans, rms."""
        return float(np.sqrt(np.mean(self.leans**2)))

    def taken_out(self, picture: Picture, number: int) -> Picture:
        """A picture as it were under light that does not lean."""
        return _evened(picture, float(self.leans[number]))


class LightMeter:
    """Tells how the light leans in pictures beside a background.

    The medians of upright strips tell it, by the median of all slopes between two (Theil 1950, Sen 1968): a joint and
    people who come by are in less than 29 % of the strips.
    """

    def __init__(self, background: NDArray[Any]) -> None:
        """Background: (rows, columns), under light that does not lean."""
        usual = _sparse(background)
        self._shape, across = usual.shape, _across(usual.shape[1])
        plain = (usual > DARK) & (usual < SATURATED)
        strips = np.array_split(np.arange(usual.shape[1]), STRIPS)
        chosen = [strip for strip in strips if plain[:, strip].any()]
        self._places = [np.flatnonzero(plain & np.isin(np.arange(usual.shape[1]), strip)) for strip in chosen]
        self._usual = [usual.ravel()[places].astype(np.float64) for places in self._places]
        self._across = np.array([across[strip].mean() for strip in chosen])

    def lean(self, picture: NDArray[Any]) -> tuple[float, float]:
        """Of the light in a picture (rows, columns), and its standard deviation; 0 and infinity where it is not
        known.
        """
        few = _sparse(picture)
        if few.shape != self._shape or len(self._places) < STRIPS // 2:
            return 0.0, np.inf
        shown = few.ravel()
        light = np.array([np.median(shown[k] / usual) for k, usual in zip(self._places, self._usual, strict=True)])
        slope, level = theilslopes(light, self._across)[:2]
        if not level > 0.0:
            return 0.0, np.inf
        left = float(np.median(np.abs(light - level - slope * self._across))) / 0.6745 / level
        deviation = left / (self._across.std() * np.sqrt(len(light)))
        return float(np.clip(slope / level, -0.9, 0.9)), float(deviation)

    def evened(self, picture: Picture) -> Picture:
        """One picture as it were under light that does not lean; the same where it surely does not."""
        lean, deviation = self.lean(picture)
        return _evened(picture, lean) if abs(lean) > max(LEAST, CERTAIN * deviation) else picture


def light_across(film: TimedPictures, background: NDArray[np.floating] | None = None) -> LightAcross | None:
    """How the light leans in a film beside a background (rows, columns), or without one beside the film's median; None
    where it does not.
    """
    few = [_sparse(picture) for _, picture in film()]
    if len({picture.shape for picture in few}) > 1:
        return None  # which is reported where it is read
    sampled = np.linspace(0, len(few) - 1, min(SAMPLED, len(few))).astype(int)
    meter = LightMeter(np.median([few[k] for k in sampled], axis=0) if background is None else background)
    leans, deviations = np.array([meter.lean(picture) for picture in few]).T
    found = LightAcross(leans=leans)
    certain = CERTAIN * float(np.sqrt(np.mean(deviations**2)))
    return found if found.size > max(LEAST, certain) else None


def _evened(picture: Picture, lean: float) -> Picture:
    """A picture without a lean of its light; what is white stays so."""
    light = 1.0 + lean * _across(picture.shape[1])
    even = np.clip(picture / light.astype(np.float32) + 0.5, 0.0, 255.0).astype(np.uint8)
    return np.where(picture < SATURATED, even, picture)


def _sparse(picture: NDArray[Any]) -> NDArray[Any]:
    every = max(picture.shape[1] // COLUMNS, 1)
    return picture[::every, ::every].copy()


def _across(columns: int) -> Array:
    """Places of columns, from -1 to 1."""
    return np.linspace(-1.0, 1.0, columns)
