"""Camera motion: how a camera moves while it films, by what stands still in its pictures (OpenCV)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

SAMPLED = 40  # pictures by which it is told what stands still
MOST, FEWEST = 400, 12  # features
APART = 1 / 60  # widths between two features
STANDING = 0.75  # share of the sampled pictures in which a feature must go with the others
BESIDE = 1.0  # pixels of 640: farther off, a feature does not go with them
UNMOVED = 0.35  # pixels of 640: features that are no farther off than that in most pictures are those of a tripod
WIDE = 0.35  # share of the picture along each axis that features must span, to tell more than a shift
FLATTER = 0.85  # of the residuals of similarities, those of homographies that are worth their four numbers more
QUIET = 0.04  # pixels of 640: a motion that is no larger is left in, as to take it out costs sharpness
CERTAIN = 2.5  # deviations of a measured motion: the same
FARTHEST = 0.15  # widths: how far a camera may look elsewhere
DISPLACED = 1.5  # pixels of 640: a camera that looks farther beside was moved, and sees the joint otherwise
ROLLS = 0.02  # rad rms: what rolls more is no camera, but the joint
MANY = 40  # features: a few are easily lost, so many only with the place
LOST = 0.2  # share of the pictures in which the camera's motion may be unknown
TimedPictures = Callable[[], Iterator[tuple[float, Picture]]]
"""Reads a film from its beginning: times [s] and pictures."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraMotion:
    """How each picture of a film lies beside one of them."""

    poses: NDArray[np.float64]
    """Homographies (pictures, 3, 3) from places in that picture to places in each [pixels]."""
    shake: float
    """How far places in the picture move, rms about their medians [pixels]."""
    farthest: float
    """The same, at most."""
    roll: float
    """How far the camera rolls, rms [rad]."""
    deviation: float
    """Standard deviation of the measured place of the picture's middle [pixels],"""
    roll_deviation: float
    """and of its roll [rad]."""
    features: NDArray[np.float32]
    """Places (features, 2) that stand still, by which that is known."""
    reference: Picture
    """The picture beside which the others lie."""
    displaced: float = 0.0
    """How far nine of ten pictures lie beside the reference at least, where this is of another film [pixels]."""

    @property
    def width(self) -> int:
        """Columns of a picture."""
        return self.reference.shape[1]

    @property
    def steady(self) -> bool:
        """Whether the camera stands: what moves is no more than what the measurement does."""
        return self.shake < max(QUIET * self.width / 640.0, CERTAIN * self.deviation)

    def taken_out(self, picture: Picture, number: int) -> Picture:
        """A picture as the camera would have taken it from where it took the reference; the same where it stands. What
        it does not show is as in the reference, so that it moves with nothing.
        """
        if self.steady:
            return picture
        import cv2

        rows, columns = picture.shape
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        pose = self.poses[number]
        found = self.reference.copy()
        cv2.warpPerspective(picture, pose, (columns, rows), found, flags=flags, borderMode=cv2.BORDER_TRANSPARENT)
        return found


def motion_of_camera(film: TimedPictures, background: NDArray[np.floating] | None = None) -> CameraMotion | None:
    """The camera's motion in a film, which is read several times; None where too little stands still in it to tell.
    background (rows, columns): of layers that were learned before, beside which it is told; otherwise it is beside a
    picture of the film.

    Features of one picture are followed to each other one (Lucas and Kanade 1981, in pyramids), those that go together
    in most pictures are what stands, and a homography or similarity of these is the pose (RANSAC).

    Raises UserError where the film can't be read, or the camera looks elsewhere, or was moved since it saw the
    background.
    """
    with extra("video"):
        import cv2
    count = sum(1 for _ in film())
    chosen = set(np.linspace(0, count - 1, min(SAMPLED, count)).astype(int).tolist())
    few = [picture for number, (_, picture) in enumerate(film()) if number in chosen]
    if len({picture.shape for picture in few}) > 1:
        return None  # which is told where it is read
    reference = few[len(few) // 2]
    if background is not None:
        if background.shape != reference.shape:
            return None
        reference = np.clip(np.round(background), 0, 255).astype(np.uint8)
    width, scale = reference.shape[1], reference.shape[1] / 640.0
    corners = cv2.goodFeaturesToTrack(reference, MOST, 0.003, APART * width)
    if corners is None or len(corners) < FEWEST:
        return None
    tracker = _Tracker(cv2, reference, np.asarray(corners, dtype=np.float32).reshape(-1, 2))
    standing = _standing(tracker, few, scale)
    if standing.sum() < FEWEST:
        tracker.flat = False  # a camera that turns far away sees what stands in perspective
        standing = _standing(tracker, few, scale)
        if standing.sum() < FEWEST:
            return None
    tracker = _Tracker(cv2, reference, tracker.features[standing])
    tracker.flat = _flat(tracker, few, scale)
    poses, residuals, known = np.tile(np.eye(3), (count, 1, 1)), np.full(count, np.nan), np.eye(3)
    for number, (_, picture) in enumerate(film()):
        pose, residuals[number] = tracker.pose(picture, known, scale)
        known = poses[number] = pose if np.isfinite(residuals[number]) else known
    if np.isnan(residuals).mean() > LOST:
        if len(tracker.features) < MANY:
            return None
        raise UserError(
            f"the camera was moved: what stands in it is not seen any more from {_lost_at(film, residuals):.3g} s on: "
            "put it on a tripod, or cut the film there"
        )
    places = moved(poses, _looks(reference.shape))
    beside = places - np.median(places, axis=0)
    deviation, roll_deviation = _deviations(tracker, few, scale)
    motion = CameraMotion(
        poses=poses,
        shake=float(np.sqrt(np.mean(beside**2) * 2.0)),
        farthest=float(np.hypot(beside[..., 0], beside[..., 1]).max()),
        roll=float(np.std(_rolls(places))),
        deviation=deviation,
        roll_deviation=roll_deviation,
        features=tracker.features,
        reference=reference,
        displaced=_displaced(places, reference.shape) if background is not None else 0.0,
    )
    if motion.displaced > max(DISPLACED * scale, motion.shake):
        raise UserError(
            f"the camera was moved: what stands lies {motion.displaced:.1f} pixels beside where it was when the layers "
            "were learned: learn them again (--learn)"
        )
    if motion.roll > ROLLS:
        return None
    if motion.farthest > FARTHEST * width:
        raise UserError(
            f"the camera was moved: it looks up to {motion.farthest:.0f} pixels elsewhere, which is more than can be "
            "taken out: put it on a tripod, or cut the film there"
        )
    return motion


class _Tracker:
    """Finds features of a reference in other pictures."""

    def __init__(self, cv2: Any, reference: Picture, features: NDArray[np.float32]) -> None:
        self.cv2, self.reference, self.features, self.flat = cv2, reference, features, True

    def found(self, picture: Picture, pose: NDArray[np.float64]) -> NDArray[np.float32]:
        """Where the features are (features, 2), from a pose on that is near; NaN where they are not found."""
        near = moved(pose[None], self.features)[0].astype(np.float32)
        places, status, _ = self.cv2.calcOpticalFlowPyrLK(
            self.reference, picture, self.features.reshape(-1, 1, 2), near.reshape(-1, 1, 2).copy(),
            winSize=(21, 21), maxLevel=3, criteria=(3, 30, 0.003), flags=self.cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=1e-5,
        )  # fmt: skip
        places = places.reshape(-1, 2)
        places[status.ravel() == 0] = np.nan
        return np.asarray(places)

    def pose(self, picture: Picture, near: NDArray[np.float64], scale: float) -> tuple[NDArray[np.float64], float]:
        """The pose of a picture, and its features' distances from it, rms [pixels]; NaN where there are too few."""
        if picture.shape != self.reference.shape:
            return near, np.nan
        places = self.found(picture, near)
        there = np.isfinite(places[:, 0])
        return self.fitted(places, there, scale)

    def fitted(
        self, places: NDArray[np.float32], there: NDArray[np.bool_], scale: float
    ) -> tuple[NDArray[np.float64], float]:
        """The same, of features that are found at places."""
        if there.sum() < FEWEST / 2:
            return np.eye(3), np.nan
        one, other = self.features[there], places[there]
        if self.flat:
            similarity, kept = self.cv2.estimateAffinePartial2D(
                one, other, method=self.cv2.RANSAC, ransacReprojThreshold=BESIDE * scale
            )
            if similarity is None:
                return np.eye(3), np.nan
            pose = np.vstack([similarity, [0.0, 0.0, 1.0]])
        else:
            pose, kept = self.cv2.findHomography(one, other, self.cv2.RANSAC, BESIDE * scale)
            if pose is None:
                return np.eye(3), np.nan
        kept = kept.ravel() > 0
        if kept.sum() < max(FEWEST / 2, 0.3 * len(self.features)):
            return pose, np.nan
        far = moved(pose[None], one[kept])[0] - other[kept]
        return pose, float(np.sqrt(np.mean(far**2)))


def _deviations(tracker: _Tracker, few: list[Picture], scale: float) -> tuple[float, float]:
    """Standard deviations of the place of the picture's middle [pixels] and of its roll [rad], rms over few pictures:
    how much they change where the features of one of six parts of the picture are left out (a jackknife; Miller 1974).
    Errors of a codec are alike in neighbouring features, and such parts are what is independent.
    """
    rows, columns = tracker.reference.shape
    block = np.floor(tracker.features / [columns, rows] * [3, 2]).clip(0, [2, 1]) @ [1, 3]
    parts = [block == part for part in np.unique(block)]
    places, rolls = [0.0], [0.0]
    for picture in few:
        found = tracker.found(picture, tracker.pose(picture, np.eye(3), scale)[0])
        there = np.isfinite(found[:, 0])
        poses = [tracker.fitted(found, there & ~part, scale) for part in parts]
        known = np.array([pose for pose, residual in poses if np.isfinite(residual)])
        if len(known) < len(parts) or len(parts) < 3:
            continue
        looks = moved(known, _looks(tracker.reference.shape))
        places.append((len(parts) - 1) * float(looks[:, 0].var(axis=0).sum()))
        rolls.append((len(parts) - 1) * float(_rolls(looks).var()))
    return float(np.sqrt(sum(places) / max(len(places) - 1, 1))), float(np.sqrt(sum(rolls) / max(len(rolls) - 1, 1)))


def _standing(tracker: _Tracker, few: list[Picture], scale: float) -> NDArray[np.bool_]:
    """Features that stand: those of a tripod where there are enough, or else those that go together."""
    places, middle = np.full((len(few), len(tracker.features), 2), np.nan, dtype=np.float32), len(few) // 2
    for order in (range(middle, len(few)), range(middle - 1, -1, -1)):  # so that each is near the one before
        near = np.eye(3)
        for k in order:
            places[k] = tracker.found(few[k], near)
            pose, residual = tracker.fitted(places[k], np.isfinite(places[k, :, 0]), scale)
            near = pose if np.isfinite(residual) else near
    beside = places - tracker.features
    still = np.hypot(beside[..., 0], beside[..., 1]) < UNMOVED * scale
    unmoved = still.mean(axis=0) > STANDING
    if unmoved.sum() >= FEWEST:
        return np.asarray(unmoved)
    together = np.zeros(still.shape, dtype=bool)
    for k in range(len(few)):
        there = np.isfinite(places[k, :, 0])
        pose, _ = tracker.fitted(places[k], there, scale)
        far = moved(pose[None], tracker.features)[0] - places[k]
        together[k] = np.hypot(far[:, 0], far[:, 1]) < BESIDE * scale
    found = together.mean(axis=0) > STANDING
    # those of a narrow place may be the joint's own
    return np.asarray(found & _wide(tracker.features[found], tracker.reference.shape)) if found.any() else found


def _flat(tracker: _Tracker, few: list[Picture], scale: float) -> bool:
    """Whether similarities explain the pictures as well as homographies do, or features are too narrow for these."""
    if len(tracker.features) < 3 * FEWEST or not _wide(tracker.features, tracker.reference.shape):
        return True
    residuals = []
    for tracker.flat in (True, False):
        residuals.append([tracker.pose(picture, np.eye(3), scale)[1] for picture in few])
    flat, deep = np.nanmedian(residuals, axis=1)
    return bool(deep > FLATTER * flat)


def _wide(features: NDArray[np.float32], shape: tuple[int, ...]) -> bool:
    low, high = np.percentile(features, [5, 95], axis=0)
    return bool((high[0] - low[0] > WIDE * shape[1]) and (high[1] - low[1] > WIDE * shape[0]))


def _looks(shape: tuple[int, ...]) -> Array:
    """Places (5, 2) at which a motion is judged: the middle, and half-way to the corners."""
    rows, columns = shape
    return np.array([[x * columns, y * rows] for x, y in ((0.5, 0.5), (0.2, 0.2), (0.8, 0.2), (0.2, 0.8), (0.8, 0.8))])


def _rolls(places: NDArray[np.float64]) -> Array:
    """How far each picture (pictures,) is rolled, by the places (pictures, 5, 2) of :func:`_looks` [rad]."""
    across = places[:, (2, 4)].mean(axis=1) - places[:, (1, 3)].mean(axis=1)
    return np.asarray(np.arctan2(across[:, 1], across[:, 0]))


def _lost_at(film: TimedPictures, residuals: Array) -> float:
    """When more than half of a second's pictures are not like the reference for the first time [s]."""
    times = np.array([time for time, _ in film()])
    lost = np.convolve(np.isnan(residuals), np.ones(15) / 15.0, mode="same") > 0.5
    return float(times[int(np.argmax(lost))])


def _displaced(places: NDArray[np.float64], shape: tuple[int, ...]) -> float:
    """How far nine of ten pictures (pictures, places, 2) lie beside the reference at least [pixels]."""
    beside = np.linalg.norm(places - _looks(shape), axis=2).max(axis=1)
    return float(np.quantile(beside, 0.1))


def moved(poses: NDArray[np.float64], places: NDArray[Any]) -> NDArray[np.float64]:
    """Places (places, 2) by poses (pictures, 3, 3): (pictures, places, 2)."""
    full = np.column_stack([places, np.ones(len(places))])
    there = full @ poses.transpose(0, 2, 1)
    return np.asarray(there[..., :2] / there[..., 2:])
