"""Footage: pictures of a simulated rig whose truth is known, sound and spoilt."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hybrid_sysid_ros.extensions.vision.camera.film import pictures, write_film
from hybrid_sysid_ros.extensions.vision.camera.filming import SceneMotion, experiment
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager, Picture
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

SECONDS = 55.0
COVER, COVER_SHADE, COVER_HERTZ = 0.12, 0.4, 0.23  # share of the width, grey, and how often it comes by


@dataclass(frozen=True, kw_only=True)
class Case:
    """A camera, and what happens to its pictures."""

    name: str
    camera: Camera
    covered: bool = False
    crf: int | None = None
    """Of the H.264 that the pictures went through; None: none."""


CASES = (
    Case(name="nominal", camera=Camera()),
    Case(name="noise 8", camera=Camera(noise=8.0)),
    Case(name="dim, 20 ms blur", camera=Camera(gain=0.5, exposure=0.02)),
    Case(name="light +-25 %, flicker 6 %", camera=Camera(light=0.25, flicker=0.06)),
    Case(name="12 % covered, moving", camera=Camera(), covered=True),
    Case(name="H.264 crf 23", camera=Camera(), crf=23),
    Case(name="H.264 crf 32", camera=Camera(), crf=32),
    Case(name="1920x1080", camera=Camera(width=1920, height=1080)),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Shots:
    """Pictures (pictures, rows, columns) at times (pictures,) [s], the imager that took them, and the true motion."""

    film: Film
    times: Array
    imager: Imager
    motion: SceneMotion

    def at_rest(self) -> Film:
        """Pictures of the second before the motion, when the joint is known to stand where it begins."""
        rate = self.imager.camera.rate
        times = self.motion.times[0] - self.imager.lead - np.arange(round(rate)) / rate
        return np.stack([self.imager.take(time, self.motion.times, self.motion.angles) for time in times])

    def truth(self, rows: Array) -> Array:
        """The joint's mean angle [rad] over the exposure of a row of each picture."""
        return np.array(
            [
                self.imager.mean_angle(time, self.motion.times, self.motion.angles, row=row)
                for time, row in zip(self.times, rows, strict=True)
            ]
        )


def motion_of(rig: Rig, *, seed: int, kind: str = "multisine", seconds: float = SECONDS) -> SceneMotion:
    """A simulated experiment's motion."""
    with TemporaryDirectory() as folder:
        return experiment(rig, kind, Path(folder) / "bag", seed=seed, duration=seconds, rate=200.0)


def shots(rig: Rig, motion: SceneMotion, case: Case, *, seed: int) -> Shots:
    """Pictures of a motion as a case has them."""
    imager = Imager(scene_of(rig), case.camera, seed=seed)
    begin, end = motion.times[0] + imager.lead, motion.times[-1] - imager.lead
    times = begin + np.arange(int((end - begin) * case.camera.rate)) / case.camera.rate
    taken: Iterator[Picture] = (imager.take(time, motion.times, motion.angles) for time in times)
    if case.covered:
        taken = (_covered(picture, time) for picture, time in zip(taken, times, strict=True))
    film = _coded(taken, times, case) if case.crf is not None else np.stack([*taken])
    return Shots(film=film, times=times, imager=imager, motion=motion)


def _covered(picture: Picture, time: float) -> Picture:
    """With somebody before it."""
    width = picture.shape[1]
    left = round((0.5 + 0.5 * np.sin(2.0 * np.pi * COVER_HERTZ * time)) * (1.0 - COVER) * width)
    picture[:, left : left + round(COVER * width)] = round(255 * COVER_SHADE)
    return picture


def _coded(taken: Iterator[Picture], times: Array, case: Case) -> Film:
    """What is left of pictures after H.264."""
    assert case.crf is not None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        write_film(path, zip(times - times[0], taken, strict=True), rate=case.camera.rate, crf=case.crf)
        return np.stack([picture for _, picture in pictures(path)])


def steady(film: Film, count: int) -> Film:
    """Pictures to learn from, as ``picked`` takes them of a file."""
    few = film[:, ::4, ::4].astype(np.int16)
    change = np.abs(np.diff(few, axis=0)).mean(axis=(1, 2))
    motion = np.maximum(np.append(np.inf, change), np.append(change, np.inf))
    edges = np.linspace(0, len(film), count + 1).astype(int)
    chosen = [a + int(np.argmin(motion[a:b])) for a, b in itertools.pairwise(edges)]
    return np.ascontiguousarray(film[chosen])
