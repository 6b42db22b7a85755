"""Film view: a film as it is read, seen squarely, as if its camera stood and its light did not lean (OpenCV)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.film import pictures
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.camera_motion import CameraMotion, motion_of_camera, moved
from hybrid_sysid_ros.extensions.vision.reading.light_across import LightAcross, light_across
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

KEPT = 400_000_000  # bytes of pictures: 55 s of 640x360 at 30 a second
CLICKED = 0.5  # pixels, rms, by which a clicked mark is beside its place


@dataclass(frozen=True, kw_only=True, eq=False)
class FilmView:
    """A film as it is read: seen squarely, where marks tell how, without the camera's motion and its light's lean."""

    path: Path
    square: NDArray[np.float64] | None = None
    """Homography (3, 3) from places in the film's pictures to those in what is seen squarely [pixels]."""
    squares: tuple[NDArray[np.float64], ...] = ()
    """The same with one coordinate of the marks each off by CLICKED."""
    motion: CameraMotion | None = None
    """The camera's own, which is taken out; None where it is not known."""
    light: LightAcross | None = None
    """How it leans, which is taken out; None where it does not."""
    kept: tuple[tuple[float, Picture], ...] = ()
    """Its times and pictures without the motion taken out, where they fit into KEPT."""

    def pictures(self) -> Iterator[tuple[float, Picture]]:
        """Times [s] and pictures. Raises UserError where the film can't be read."""
        for number, (time, picture) in enumerate(self.kept or self._decoded()):
            for disturbance in (self.motion, self.light):
                picture = picture if disturbance is None else disturbance.taken_out(picture, number)
            yield time, picture

    def _decoded(self) -> Iterator[tuple[float, Picture]]:
        for time, picture in pictures(self.path):
            yield time, picture if self.square is None else squared(picture, self.square)

    def _held(self) -> FilmView:
        """The same with its pictures in memory, as it is read some eight times."""
        kept, size = list[tuple[float, Picture]](), 0
        for item in self._decoded():
            kept.append(item)
            size += item[1].nbytes
            if size > KEPT:
                return self
        return replace(self, kept=tuple(kept))

    def scale_deviation(self, pivot: tuple[float, float], angles: Array) -> float:
        """Relative standard deviation of the size of angles (pictures,) [rad] about a pivot [pixels], by marks that are
        beside their places: what is seen about the pivot is then mapped by a matrix A, and an angle in a direction d
        changes by det A / |A d|^2 times its own change.
        """
        if self.square is None:
            return 0.0
        directions = np.stack([np.cos(angles), -np.sin(angles)])
        variance = 0.0
        for square in self.squares:
            mapped = square @ np.linalg.inv(self.square)
            x, y, w = mapped @ np.array([*pivot, 1.0])
            there = (mapped[:2, :2] - np.outer([x / w, y / w], mapped[2, :2])) / w
            variance += float(np.nanmean((np.linalg.det(there) / np.sum((there @ directions) ** 2, axis=0) - 1.0) ** 2))
        return float(np.sqrt(variance))

    def film_rows(self, column: float, rows: Array) -> Array:
        """Rows (pictures,) of the film's own pictures, whose time rows of what is seen of them have, in a column."""
        places = np.column_stack([np.full(len(rows), column), rows])
        if self.motion is not None and not self.motion.steady:
            places = np.array(
                [moved(pose[None], place[None])[0, 0] for pose, place in zip(self.motion.poses, places, strict=True)]
            )
        if self.square is not None:
            places = moved(np.linalg.inv(self.square).astype(np.float64)[None], places)[0]
        return np.asarray(places[:, 1])

    def steadied(self, background: NDArray[np.floating] | None = None) -> FilmView:
        """The same with motion and light taken out; see :func:`motion_of_camera` and :func:`light_across`."""
        held = self._held()
        held = replace(held, motion=motion_of_camera(held.pictures, background))
        return replace(held, light=light_across(held.pictures, background))


def squared(picture: Picture, square: NDArray[np.float64]) -> Picture:
    """A picture as it is seen squarely, by a homography."""
    import cv2

    rows, columns = picture.shape
    found = cv2.warpPerspective(
        picture, square, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(found)


def squaring(marks: Array, rectangle: tuple[float, ...]) -> NDArray[np.float64]:
    """The homography that makes four marks (4, 2) [pixels], from the upper left one clockwise, the corners of an
    upright rectangle of a width and a height in any unit; their middle and their mean width stay.

    Raises UserError where three of the marks lie on a line, or they go the other way round.
    """
    with extra("video"):
        import cv2
    sides = np.roll(marks, -1, axis=0) - marks
    turns = sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0]
    if not (turns > 1.0).all():
        raise UserError("the four marks are no corners of a rectangle, from the upper left one clockwise")
    wide = float(np.hypot(*sides[[0, 2]].T).mean())
    half = np.array([wide, wide * rectangle[1] / rectangle[0]]) / 2.0
    corners = marks.mean(axis=0) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(cv2.getPerspectiveTransform(marks.astype(np.float32), corners.astype(np.float32)))
