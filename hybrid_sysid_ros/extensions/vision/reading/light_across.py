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
        """A picture as it were under light that does not lean; what is white stays so."""
        lean = 1.0 + self.leans[number] * _across(picture.shape[1])
        even = np.clip(picture / lean.astype(np.float32) + 0.5, 0.0, 255.0).astype(np.uint8)
        return np.where(picture < SATURATED, even, picture)


def light_across(film: TimedPictures, background: NDArray[np.floating] | None = None) -> LightAcross | None:
    """How the light leans in a film beside a background (rows, columns), or without one beside the film's median; None
    where it does not.

    The medians of upright strips tell it, by the median of all slopes between two (Theil 1950, Sen 1968): a joint and
    people who come by are in less than 29 % of the strips.
    """
    few = [_sparse(picture) for _, picture in film()]
    if len({picture.shape for picture in few}) > 1:
        return None  # which is reported where it is read
    sampled = np.linspace(0, len(few) - 1, min(SAMPLED, len(few))).astype(int)
    usual = np.median([few[k] for k in sampled], axis=0) if background is None else _sparse(background)
    if usual.shape != few[0].shape:
        return None
    plain = (usual > DARK) & (usual < SATURATED)
    strips = np.array_split(np.arange(usual.shape[1]), STRIPS)
    chosen = [strip for strip in strips if plain[:, strip].any()]
    if len(chosen) < STRIPS // 2:
        return None
    across = np.array([_across(usual.shape[1])[strip].mean() for strip in chosen])
    leans, deviations = np.zeros(len(few)), np.zeros(len(few))
    for number, picture in enumerate(few):
        quotient = np.where(plain, picture, np.nan) / usual
        light = np.array([np.nanmedian(quotient[:, strip]) for strip in chosen])
        slope, level = theilslopes(light, across)[:2]
        if level > 0.0:
            leans[number] = np.clip(slope / level, -0.9, 0.9)
            left = float(np.median(np.abs(light - level - slope * across))) / 0.6745 / level
            deviations[number] = left / (across.std() * np.sqrt(len(chosen)))
    found = LightAcross(leans=leans)
    certain = CERTAIN * float(np.sqrt(np.mean(deviations**2)))
    return found if found.size > max(LEAST, certain) else None


def _sparse(picture: NDArray[Any]) -> NDArray[Any]:
    every = max(picture.shape[1] // COLUMNS, 1)
    return picture[::every, ::every].copy()


def _across(columns: int) -> Array:
    """Places of columns, from -1 to 1."""
    return np.linspace(-1.0, 1.0, columns)
