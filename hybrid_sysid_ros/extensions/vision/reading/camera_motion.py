"""Camera motion: how a camera moves while it films, by what stands still in its pictures (OpenCV)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.feature_tracker import (
    BESIDE,
    FEWEST,
    UNMOVED,
    FeatureTracker,
    moved,
    standing_features,
    tell_lens,
    wide,
)
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

SAMPLED = 40  # pictures that show what stands still
QUIET = 0.04  # pixels of 640: a motion that is no larger is left in, as to take it out costs sharpness
CERTAIN = 2.5  # deviations of a measured motion: the same
FARTHEST = 0.15  # widths: how far a camera may look elsewhere
DISPLACED = 1.5  # pixels of 640: a camera that looks farther beside was moved, and sees the joint otherwise
ROLLS = 0.02  # rad rms: what rolls more may be the joint,
ALL_OVER = 0.7  # unless it spans so much of the picture along each axis
LEVER = 0.3  # of the width: the distance over which few features tell how the camera rolls
MANY = 40  # features: a few are easily lost, so many only with the place
MOST, TORN = 0.75, 3.0
"""Share of what stands, and times as far beside its place as in most pictures, in one that is torn: a camera that
shakes while its rows are read moves those of one half beside the other's."""
LOST = 0.2  # share of the pictures in which the camera's motion may be unknown
CUT, ASIDE = 4.0, 8  # times as much as pictures change otherwise, and pictures on each side, by which a cut is known
DIFFERS, ALIKE = 10.0, 0.5  # counts by which a pixel is another, and correlation of two views that are one
COVERS = 0.3  # of the picture: a joint that steps changes less
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
    torn: NDArray[np.bool_]
    """Pictures (pictures,) whose own parts moved beside one another, which no pose takes out."""
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
    background (rows, columns): of layers that were learned before, beside which it is given; otherwise it is beside a
    picture of the film.

    Features of one picture are followed to each other one (Lucas and Kanade 1981, in pyramids), those that go together
    in most pictures are what stands (RANSAC), and a camera that turns, a similarity or a homography of these is the
    pose.

    Raises UserError where the film can't be read, or goes on with another view, or the camera looks elsewhere, or was
    moved since it saw the background.
    """
    with extra("video"):
        import cv2
    _refuse_cut(film)
    count = sum(1 for _ in film())
    chosen = set(np.linspace(0, count - 1, min(SAMPLED, count)).astype(int).tolist())
    few = [picture for number, (_, picture) in enumerate(film()) if number in chosen]
    if len({picture.shape for picture in few}) > 1:
        return None  # which is reported where it is read
    reference = few[len(few) // 2]
    if background is not None:
        if background.shape != reference.shape:
            return None
        reference = np.clip(np.round(background), 0, 255).astype(np.uint8)
    width, scale = reference.shape[1], reference.shape[1] / 640.0
    standing = standing_features(cv2, reference, few, scale)
    if standing is None:
        _refuse_other_view(few[: len(few) // 4], few[-len(few) // 4 :])
        return None
    features, tripod = standing
    tracker = FeatureTracker(cv2, reference, features)
    if not tripod:
        tell_lens(tracker, few, scale)
    poses, residuals, known = np.tile(np.eye(3), (count, 1, 1)), np.full(count, np.nan), np.eye(3)
    rest = np.full((count, *features.shape), np.nan, dtype=np.float32)
    for number, (_, picture) in enumerate(film()):
        pose, residuals[number], rest[number] = tracker.pose_and_rest(picture, known, scale)
        known = poses[number] = pose if np.isfinite(residuals[number]) else known
    if np.isnan(residuals).mean() > LOST:
        if len(tracker.features) < MANY:
            _refuse_other_view(few[: len(few) // 4], few[-len(few) // 4 :])
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
        torn=_torn(rest, places, scale),
        displaced=_displaced(places, reference.shape) if background is not None else 0.0,
    )
    if motion.displaced > max(DISPLACED * scale, motion.shake):
        raise UserError(
            f"the camera was moved: what stands lies {motion.displaced:.1f} pixels beside where it was when the layers "
            "were learned: learn them again (--learn)"
        )
    if motion.roll > ROLLS and not wide(tracker.features, reference.shape, ALL_OVER):
        return None
    if motion.farthest > FARTHEST * width:
        raise UserError(
            f"the camera was moved: it looks up to {motion.farthest:.0f} pixels elsewhere, which is more than can be "
            "taken out: put it on a tripod, or cut the film there"
        )
    return motion


def _refuse_other_view(first: list[Picture], last: list[Picture]) -> None:
    """Raise UserError where a film ends with another view than it begins with."""
    if not _alike(first, last):
        raise UserError(
            "the camera was moved: the film ends with another view than it begins with: put it on a tripod, or cut the "
            "film where it moves"
        )


def _alike(first: list[Picture], last: list[Picture]) -> bool:
    """Whether two parts of a film show one view, by their medians; even ones do."""
    one, other = (np.median([picture[::4, ::4] for picture in part], axis=0) for part in (first, last))
    if (np.abs(other - one) > DIFFERS).mean() < COVERS or not min(np.ptp(one), np.ptp(other)) > DIFFERS:
        return True
    return bool(np.corrcoef(one.ravel(), other.ravel())[0, 1] >= ALIKE)


def _torn(rest: NDArray[np.float32], places: Array, scale: float) -> NDArray[np.bool_]:
    """Pictures (pictures,) that are torn, by where their features lie beside their places (pictures, features, 2)
    [pixels]; what is so in most pictures is the reference's own. places (pictures, looks, 2): of the camera, which
    moves meanwhile; where it stands, a codec has moved the features.
    """
    known = rest[:, np.isfinite(rest[..., 0]).mean(axis=0) > 0.5]
    beside = np.linalg.norm(known - np.nanmedian(known, axis=0), axis=2)
    seen = np.isfinite(beside).any(axis=1)
    apart = np.zeros(len(rest))
    apart[seen] = np.nanquantile(beside[seen], MOST, axis=1)
    steps = np.pad(np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1), 1)
    shakes = np.maximum(steps[:-1], steps[1:]) > UNMOVED * scale
    return shakes & (apart > max(UNMOVED * scale, min(TORN * float(np.median(apart)), BESIDE * scale)))


def _refuse_cut(film: TimedPictures) -> None:
    """Raise UserError where a film goes on with another view from one picture to the next."""
    times, changes, before = list[float](), list[float](), None
    for time, picture in film():
        few = picture[::4, ::4].astype(np.float32)
        if before is not None and before.shape != few.shape:
            return  # which is reported where it is read
        times.append(time)
        changes.append(float(np.abs(few - before).mean()) if before is not None else 0.0)
        before = few
    first = int(np.argmax(changes))
    if len(changes) < ASIDE or not changes[first] > CUT * np.sort(changes)[-3]:  # two of a film may be cuts
        return
    near = [picture for k, (_, picture) in enumerate(film()) if abs(k + 0.5 - first) < ASIDE]
    if not _alike(near[: min(first, ASIDE)], near[min(first, ASIDE) :]):
        raise UserError(
            f"the camera was moved, or the film is of two takes: from {times[first]:.3g} s on it shows another view: "
            "cut it there"
        )


def unknown_shake(wander: float) -> UserError:
    """The refusal of a film whose joint's pivot moves by so much, rms [pixels], with a camera of unknown motion."""
    return UserError(
        f"the camera shakes: the joint's pivot moves by {wander:.2g} pixels in the pictures, rms, and too little "
        "stands still in them to tell how: put the camera on a tripod, or film before a wall with a pattern"
    )


def _deviations(tracker: FeatureTracker, few: list[Picture], scale: float) -> tuple[float, float]:
    """Standard deviations of the place of the picture's middle [pixels] and of its roll [rad], rms over few pictures:
    how much they change where the features of one of six parts of the picture are left out (a jackknife; Miller 1974).
    Errors of a codec are alike in neighbouring features, and such parts are what is independent.
    """
    rows, columns = tracker.reference.shape
    block = np.floor(tracker.features / [columns, rows] * [3, 2]).clip(0, [2, 1]) @ [1, 3]
    parts = [block == part for part in np.unique(block)]
    places, rolls = list[Array](), list[Array]()
    for picture in few:
        found = tracker.found(picture, tracker.pose(picture, np.eye(3), scale)[0])
        pose, residual = tracker.fitted(found, np.isfinite(found[:, 0]), scale)
        if not np.isfinite(residual) or len(parts) < 3:
            continue
        far = moved(pose[None], tracker.features)[0] - found
        near = np.hypot(far[:, 0], far[:, 1]) < BESIDE * scale
        if min((near & ~part).sum() for part in parts) < FEWEST / 2:
            continue
        known = np.array(
            [tracker.least_squares(tracker.features[kept], found[kept]) for kept in near & ~np.array(parts)]
        )
        looks = moved(known, _looks(tracker.reference.shape))
        places.append(looks[:, 0] - looks[:, 0].mean(axis=0))
        rolls.append(_rolls(looks) - _rolls(looks).mean())
    if not places:  # too few in some part: as if their errors were independent, at the sides half as well
        residuals = [tracker.pose(picture, np.eye(3), scale)[1] for picture in few]
        place = 2.0 * float(np.nanmedian(residuals)) / np.sqrt(len(tracker.features))
        return place, place / (LEVER * columns)
    # what is the same in all pictures is the reference's own error, which is a gauge
    place, roll = (np.var(changes, axis=0).mean(axis=0).sum() for changes in (places, rolls))
    return float(np.sqrt((len(parts) - 1) * place)), float(np.sqrt((len(parts) - 1) * roll))


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
