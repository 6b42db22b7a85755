"""Footage: a film looked at: pictures to learn from, and what all of them say of angle and lamp."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.film import format_of
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.camera.quantisation import quantiser_steps
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import LIT, STANDS, AngleReader, AngleReading, FreeReading
from hybrid_sysid_ros.extensions.vision.reading.camera_motion import CameraMotion
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.focus import sharpness, soft_pictures
from hybrid_sysid_ros.extensions.vision.reading.lamp import brightness
from hybrid_sysid_ros.extensions.vision.reading.learning import DARK_FILM, FEWEST
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.extensions.vision.reading.steadiness import GAP, steady_angles
from hybrid_sysid_ros.extensions.vision.reading.unused_pictures import (
    Unused,
    copied_pictures,
    dim_pictures,
    frozen_pictures,
    leaping_pictures,
    unlike_pictures,
)
from hybrid_sysid_ros.extensions.vision.scene import Lamp
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LEARNED_FROM = 160
"""Pictures that layers are learned from."""
SHOWN = 4  # pictures that are kept to be shown
LOOKS, APART = 16, 10
"""Pictures, and how far apart, by which a moved camera is known; who comes by is in less than half of them."""
MOST_EVEN = 0.05  # of a film's pictures that show nothing, here and there
PLAIN = 12  # counts, by which the pixels of a picture differ at least that shows something: a film's black is not 0
OTHER_RATE = 0.01  # relative difference of a film's rate from what its head says, that is reported
LOST = 0.5  # share of the pictures without an angle, with which a film is none of these layers


@dataclass(frozen=True, kw_only=True, eq=False)
class Footage:
    """What a film's pictures say, (frames,) each."""

    times: Array
    """Of the pictures, as the film has them [s]."""
    seen: Array
    """Of the sprite in them: the rows that tell of it are exposed then [s]."""
    angles: Array
    """[rad]; NaN where there is none."""
    deviations: Array
    """[rad]"""
    explained: Array
    """Share of the pixels that the layers explain."""
    lamp: Array
    """Brightness of the lamp [counts]; NaN without one, and where there is no light in the picture."""
    unused: Mapping[Unused, NDArray[np.bool_]]
    """Pictures whose angles are not used, by why; the first reason counts."""
    shown: tuple[tuple[float, Picture, AngleReading], ...]
    """Some of them, with their times and what was read."""
    stated_rate: float
    """What the film's head says [Hz]."""
    view: FilmView | None = None
    """As which the film was read."""

    @property
    def motion(self) -> CameraMotion | None:
        """The camera's own, which was taken out; None where it was not measured."""
        return None if self.view is None else self.view.motion

    @property
    def rate(self) -> float:
        """Pictures a second, by their times [Hz], without gaps; a median alone would be of times that are rounded."""
        apart = np.diff(self.times)
        return 1.0 / float(apart[apart < GAP * np.median(apart)].mean())

    @property
    def lost(self) -> int:
        """Pictures without an angle."""
        return int(np.isnan(self.angles).sum())

    def why(self, number: int) -> Unused:
        """The angle of a picture is not used, or there is none."""
        return next((why for why, pictures in self.unused.items() if pictures[number]), Unused.HIDDEN)

    def without(self, why: Unused, pictures: NDArray[np.bool_]) -> Footage:
        """The same without the angles of some more pictures (frames,)."""
        angles = np.where(pictures, np.nan, self.angles)
        return replace(self, angles=angles, unused={**self.unused, why: pictures})

    def unsurer(self, beside: Array | float) -> Footage:
        """The same, its deviations with one more, (frames,) [rad], that is independent of them."""
        return replace(self, deviations=np.hypot(self.deviations, np.nan_to_num(beside)))

    def turned_unsurely(self, relative: float) -> Footage:
        """The same, its deviations with that of the angles' scale by a pivot that may be off: an error that goes as the
        sine of the angle, and comes back after a turn. Angles of a camera that moves hang on no pivot.
        """
        if self.motion is not None and not self.motion.steady:
            return self
        beside = relative * np.minimum(np.abs(self.angles - np.nanmean(self.angles)), 1.0)
        return self.unsurer(beside)

    def remarks(self) -> list[str]:
        """What a user should know of the film, in a line each."""
        found = []
        if (motion := self.motion) is not None and not motion.steady:
            found.append(f"the camera moves by {motion.shake:.2g} pixels, rms, by what stands: taken out")
        if self.view is not None and self.view.light is not None:
            found.append(f"the light leans from side to side by {self.view.light.size:.0%}, rms: taken out")
        if self.stated_rate and abs(self.rate / self.stated_rate - 1.0) > OTHER_RATE:
            found.append(f"its head says {self.stated_rate:.4g} pictures/s, their times {self.rate:.4g}: these count")
        counts = Counter(self.why(k) for k in np.flatnonzero(np.isnan(self.angles)))
        found += [f"{count} of {len(self.angles)} pictures are {why.note}: not used" for why, count in counts.items()]
        return found


def picked(view: FilmView, count: int = LEARNED_FROM) -> Film:
    """Pictures of a film to learn from (pictures, rows, columns): of each of as many parts the one with least motion,
    so that none is smeared, and none that is out of focus.

    Raises UserError where the film can't be read, is too short, or changes its size.
    """
    moved, sharp, before, shape = list[float](), list[float](), None, None
    for time, picture in view.pictures():
        few = picture[::4, ::4].astype(np.int16)
        if shape not in (None, picture.shape):
            raise UserError(f"{view.path}: its pictures change their size at {time:.3g} s: cut it there")
        shape = picture.shape
        moved.append(float(np.abs(few - before).mean()) if before is not None else np.inf)
        sharp.append(sharpness(picture))
        before = few
    if len(moved) < FEWEST:
        raise UserError(f"{view.path}: has {len(moved)} pictures: {FEWEST} at least are needed to learn from")
    edges = np.linspace(0, len(moved), min(count, len(moved)) + 1).astype(int)
    steady = np.maximum(moved, np.append(moved[1:], np.inf))
    steady[soft_pictures(np.array(sharp))] = np.inf
    chosen = {a + int(np.argmin(steady[a:b])) for a, b in itertools.pairwise(edges) if np.isfinite(steady[a:b]).any()}
    return np.stack([picture for k, (_, picture) in enumerate(view.pictures()) if k in chosen])


def followed(
    view: FilmView, reader: AngleReader, lamp: Lamp | None, *, progress: Callable[[int], object] = lambda count: None
) -> Footage:
    """What each picture of a film says by layers.

    Raises UserError where the film can't be read, has another size, shows something else than the layers, or shakes
    in a way that can't be taken out.
    """
    rows, times, lamps, free = list[AngleReading](), list[float](), list[float](), list[FreeReading]()
    even, equal, sharp, lights = list[bool](), list[bool](), list[float](), list[float]()
    sceneries = list[Array]()
    shown = list[tuple[float, Picture, AngleReading]]()
    before, every = np.zeros(0, dtype=np.uint8), 1
    for time, picture in view.pictures():
        reading, plain = reader.read(picture), int(np.ptp(picture[::8, ::8])) < PLAIN
        if plain:
            reading = replace(reading, angle=np.nan, deviation=np.inf)
        even.append(plain)
        equal.append(bool(rows) and reader.lit and not plain and np.array_equal(picture, before))
        sharp.append(np.inf if plain else sharpness(picture))
        before = picture
        lights.append(float(np.median(reader.gains)))
        times.append(time)
        rows.append(reading)
        free.append(reader.read_freely(picture, reading.angle, reader.gains))
        lamps.append(brightness(picture, lamp) if lamp is not None and reader.lit else np.nan)
        if (len(rows) - 1) % APART == 0:
            sceneries.append(reader.scenery(picture))
        if (len(rows) - 1) % every == 0:
            shown.append((time, picture, reading))
            if len(shown) >= 4 * SHOWN:
                every, shown = 2 * every, shown[::2]
            progress(len(rows))
    unlike = unlike_pictures(np.array([row.difference for row in rows]))
    rows = [replace(row, angle=np.nan, deviation=np.inf) if k else row for row, k in zip(rows, unlike, strict=True)]
    layers, angles = reader.layers, np.array([row.angle for row in rows])
    if len(rows) < 2:
        raise UserError(f"{view.path}: has one picture only")
    lost = float(np.isnan(angles).mean())
    light = float(np.median([item[1].mean() for item in shown]))
    if light < LIT * layers.background.mean():
        raise UserError(f"{view.path}: its pictures are black, {lost:.0%} of them without the joint: nothing is read")
    _refuse_dark(view, np.flatnonzero(even), len(even), light)
    steady = steady_angles(np.array(times), rows, free, view.motion, layers, quantiser_steps(view.path))
    for first in range(0, max(len(sceneries) - LOOKS // 2, 1), LOOKS // 2):
        stands = reader.standing(sceneries[first : first + LOOKS])
        if stands < STANDS:
            raise UserError(
                f"{view.path}: what stands in it {_when(times, first)}is not where it was when the layers of "
                f"{layers.geometry.rig} were learned (correlation {stands:.3f}, {STANDS:g} at least): the camera was "
                f"moved, or it is another rig's film; {'cut it there' if first else 'learn them again (--learn)'}"
            )
    if lost > LOST:
        raise UserError(
            f"{view.path}: {lost:.0%} of its pictures are not what the layers of {layers.geometry.rig} explain: "
            "it shows another rig, or the joint is hidden; learn them again (--learn)"
        )
    angles = steady.angles
    unused = {
        Unused.FROZEN: frozen_pictures(np.array(equal), angles, layers.reach) | copied_pictures(angles * layers.reach),
        Unused.SOFT: soft_pictures(np.array(sharp)),
        Unused.DIM: dim_pictures(np.array(lights)),
    }
    if view.motion is not None:
        unused[Unused.TORN] = view.motion.torn
    angles[np.any(list(unused.values()), axis=0)] = np.nan
    if not layers.full_turn:
        angles[leaping_pictures(angles)] = np.nan
    middle = np.nan_to_num([layers.row_time(row) for row in view.film_rows(layers.pivot[0], steady.rows)])
    good = [item for item in shown if item[2].found] or shown
    return Footage(
        times=np.array(times),
        seen=np.array(times) + middle,
        angles=_unwrapped(angles, layers.period) if layers.full_turn else angles,
        deviations=steady.deviations,
        explained=np.array([row.explained for row in rows]),
        lamp=np.array(lamps),
        unused=unused,
        shown=tuple(good[:: max(len(good) // SHOWN, 1)][:SHOWN]),
        stated_rate=format_of(view.path).rate,
        view=view,
    )


def _refuse_dark(view: FilmView, even: NDArray[np.intp], count: int, light: float) -> None:
    """Raise UserError where pictures that show nothing, some of ``count``, are all over a dark film: no cut helps."""
    if light < DARK_FILM and len(even) > MOST_EVEN * count and np.ptp(even) > 0.5 * count:
        raise UserError(
            f"{view.path}: it is too dark, {light:.0f} of 255 counts: in {len(even) / count:.0%} of its pictures "
            f"nothing differs by {PLAIN} counts; film with more light, or a longer exposure"
        )


def _when(times: Sequence[float], first: int) -> str:
    """What is said of a scenery that is not the first."""
    return f"from {times[first * APART]:.3g} s on " if first else ""


def _unwrapped(angles: Array, period: float) -> Array:
    """Angles that go on round and round, by the shorter way from one picture to the next, known but for a period."""
    found, known = angles.copy(), np.isfinite(angles)
    found[known] = np.unwrap(angles[known], period=period)
    return found
