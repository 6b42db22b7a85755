"""Steadiness: whether a joint's pivot stands in the pictures of a film, and what its angles are where it does not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReading, FreeReading
from hybrid_sysid_ros.extensions.vision.reading.camera_motion import CameraMotion, unknown_shake
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.learning import DARK_FILM
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

ENOUGH = 20  # pictures
OUTLIER = 5.0  # deviations
WANDERS = 0.12  # pixels of 640: a pivot that moves less, rms, stands
LEAVES = 3.0  # pixels of 640: one that moves more, the camera's motion taken out, is no pivot
ORDER = 12  # of the differences that show what is new in each picture
GROWS = 1.25 * math.sqrt(ORDER + 1.0)
"""Times as much every second picture tells of an error that is kept for two, by ORDER's binomials, and
a quarter for what medians of some hundred differences are uncertain by."""
SLOWEST = 23.0  # pictures a second, at which a joint's motion has no part in them yet
GAP = 1.5  # times as far apart as most are pictures between which one is missing
OFTEN = 0.9  # share of the pictures that are no farther apart than what counts as usual
CHI_SQUARE = 0.455  # median, of one degree of freedom
HELD, STILL = 0.25, 4  # deviations by which angles differ at most that are one, and how many in a row a codec repeats
LEFT_OUT = 0.034
"""Of a quantiser's step, rms, by which edges are off, all to one side, as a codec draws nothing anew that rounds to
nothing; mean of three seeds at H.264's qualities 20, 26 and 32, by python -m benchmarks.camera coding."""
COARSE = 0.15  # pixels of 640 by which a sprite's end is beside its place by that, rms: a film that is refused
STRONG = 40.0  # counts of a quantiser, with which compression is to blame


@dataclass(frozen=True, kw_only=True, eq=False)
class SteadyAngles:
    """Angles (pictures,) of a film, NaN where there is none."""

    angles: Array
    """[rad]"""
    deviations: Array
    """Standard deviations [rad]."""
    rows: Array
    """Whose time they are of."""


def steady_angles(
    times: Array, rows: Sequence[AngleReading], free: Sequence[FreeReading], motion: CameraMotion | None,
    layers: PictureLayers, steps: Array,
) -> SteadyAngles:  # fmt: skip
    """The angles of pictures at times (pictures,) [s] out of which a camera's motion was taken. steps (pictures,): of
    the codec's quantiser [counts], NaN where they are not known.

    Where the pivot stands they are those about it. Where it moves with the camera they are those that no place of the
    sprite changes, and what stands must have shown how the camera rolls. The deviation has what the two kinds of angles
    differ by beyond their own deviations, and what the camera's motion is uncertain by. A codec moves what a picture
    shows as a whole, which no residual tells: by what its quantiser leaves out. Where that is not known, or pictures
    are twice as many as SLOWEST, the deviation is no less than what angles scatter by from picture to picture; of fewer
    ones a joint's own unrest has a part in that.

    Raises UserError where the pivot moves and nothing tells how the camera does, and where the codec leaves too little.
    """
    about = np.array([[row.angle, row.deviation, row.row] for row in rows])
    freely = np.array([[row.angle, row.deviation, row.row, row.x, row.y, row.beside] for row in free])
    known = np.isfinite(about[:, 0]) & np.isfinite(freely).all(axis=1)
    pixel = layers.background.shape[1] / 640.0
    wander, unsteady = _wander(times[known], freely[known], pixel) if known.sum() >= ENOUGH else (0.0, 0.0)
    if wander > WANDERS * pixel and motion is None:
        raise unknown_shake(wander)
    if wander > LEAVES * pixel:
        raise UserError(
            f"the camera moves otherwise than what stands in its pictures tells: the joint's pivot moves by "
            f"{wander:.2g} pixels beside that, rms: put the camera on a tripod"
        )
    moves = wander > WANDERS * pixel or (motion is not None and not motion.steady)
    chosen = freely if moves else about
    common = 0.0 if moves or not known.any() else _apart(about[known], freely[known])
    if motion is not None:
        # the pivot tells how uncertain the place is in truth, and the roll is as much more so
        more = max(unsteady / max(motion.deviation, 1e-9), 1.0) if moves else 1.0
        common += (more * motion.roll_deviation if moves else min(motion.roll, motion.roll_deviation)) ** 2
    angles = np.where(np.isfinite(about[:, 0]), chosen[:, 0], np.nan)
    own = chosen[:, 1] ** 2 + common
    repeated = held(angles, np.sqrt(own))
    left_out = LEFT_OUT * steps * [row.per_count for row in rows]
    _refuse_coarse(steps, left_out * layers.reach / pixel, float(layers.background.mean()))
    scattered = scatter(times, angles, layers.period, repeated)
    coded = np.where(np.isfinite(left_out), own + left_out**2, scattered**2)
    deviations = np.sqrt(np.maximum(own, coded))
    new = np.isfinite(deviations) & ~repeated
    if new.any() and 2.0 * SLOWEST * float(np.median(np.diff(times))) < 1.0:
        deviations *= max(scattered / float(np.median(deviations[new])), 1.0)
    return SteadyAngles(angles=angles, deviations=deviations, rows=chosen[:, 2])


def _refuse_coarse(steps: Array, beside: Array, light: float) -> None:
    """Raise UserError where a codec leaves too little of a joint's edges, by its quantiser's steps (pictures,) [counts]
    and by how far the sprite's end is beside its place in them (pictures,) [pixels of 640]. light: of the film
    [counts].
    """
    known = np.isfinite(beside)
    if not known.any() or (far := float(np.median(beside[known]))) < COARSE:
        return
    step = float(np.median(steps[known]))
    why, advice = "the joint's edges are soft, blurred or faint", "focus on the joint, with more light and contrast"
    if light < DARK_FILM:
        why, advice = f"it is too dark, {light:.0f} of 255 counts", "film with more light, or a longer exposure"
    elif step > STRONG:
        why, advice = "the film is compressed strongly", "record with more bits a second"
    raise UserError(
        f"{why}: its codec leaves out what is smaller than {step:.0f} counts, and so the joint's end lies {far:.2g} of "
        f"640 pixels beside its place, rms, {COARSE} at most: {advice}"
    )


def held(angles: Array, deviations: Array) -> NDArray[np.bool_]:
    """Angles (pictures,) that go on for STILL pictures and more to within HELD of their deviations: what a codec
    repeats while nothing moves is one picture with one error, and no new one tells of it.
    """
    same = np.append(False, np.abs(np.diff(angles)) < HELD * deviations[1:]).astype(int)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same, [0]])))
    found = np.zeros(len(angles), dtype=bool)
    for first, end in edges.reshape(-1, 2).tolist():
        found[first:end] = end - first >= STILL
    return found


def scatter(
    times: Array, angles: Array, period: float = 0.0, repeated: NDArray[np.bool_] | None = None, *, white: bool = False
) -> float:
    """Standard deviation of what is new in each of the angles (pictures,) at times [s], by their divided differences of
    a high order, in which a motion well below half the pictures' rate has no part; their median, so that no jump has
    any; 0 where too few follow one another. period: of angles that go round, 0 for others. repeated: pictures in
    which nothing is new, see :func:`held`. white: whether all is new in each angle, as in those of an encoder.

    A codec keeps its errors from one picture to the next. Where pictures are many, every second, fourth and eighth tell
    it, too, as long as they are SLOWEST, and the largest of these counts. What grows by more than GROWS is the motion.
    """
    known = np.isfinite(angles)
    when, seen = times[known], np.unwrap(angles[known], period=period) if period else angles[known]
    old = np.zeros(len(when), dtype=bool) if repeated is None else repeated[known]
    if len(when) < ENOUGH + ORDER:
        return 0.0
    usual, stride = float(np.quantile(np.diff(when), OFTEN)), 1  # also where every third picture is missing
    most = _new(when, seen, old, stride, usual)
    while not white and 2 * stride * usual * SLOWEST <= 1.0:
        stride *= 2
        if (new := _new(when, seen, old, stride, usual)) > GROWS * most:
            break
        most = max(most, new)
    return most


def _new(when: Array, seen: Array, old: NDArray[np.bool_], stride: int, usual: float) -> float:
    """The same of every so many pictures, most of which are ``usual`` apart [s]; windows of old ones don't count."""
    if len(when) < ENOUGH + ORDER * stride:
        return 0.0
    windows, values = (sliding_window_view(item, ORDER * stride + 1)[:, ::stride] for item in (when, seen))
    repeats = sliding_window_view(old, ORDER * stride + 1)[:, ::stride].mean(axis=1)
    together = (np.diff(windows, axis=1).max(axis=1) < GAP * stride * usual) & (repeats < 0.5)
    if together.sum() < ENOUGH:
        return 0.0
    apart = windows[:, :, None] - windows[:, None, :]
    apart = apart / np.abs(apart).max(axis=(1, 2), keepdims=True) + np.eye(ORDER + 1)
    weights = 1.0 / apart.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    new = (weights * values).sum(axis=1)[together]
    return float(np.median(np.abs(new))) / 0.6745


def _apart(about: Array, free: Array) -> float:
    """Variance by which angles about the pivot differ from free ones beyond what these state, as far as it is theirs:
    the less sure ones have the larger part of it.
    """
    beyond = (free[:, 0] - about[:, 0]) ** 2 - free[:, 1] ** 2
    share = float(np.median(about[:, 1] / (about[:, 1] + free[:, 1])))
    return share * max(float(np.median(beyond)) / CHI_SQUARE, 0.0)


def _wander(times: Array, free: Array, pixel: float) -> tuple[float, float]:
    """How far the place moves, rms, without outliers, a pivot that is off, and what its own deviation is; and the same
    of what is new in each picture, as errors are, but not a joint that is nearer than the wall.
    """
    angles, moves = free[:, 0], free[:, 3:5]
    regressors = np.column_stack([np.ones(len(angles)), np.cos(angles), np.sin(angles)])
    used = np.ones(len(angles), dtype=bool)
    for _ in range(3):
        fitted = np.linalg.lstsq(regressors[used], moves[used], rcond=None)[0]
        left = np.hypot(*(moves - regressors @ fitted).T)
        used = left <= OUTLIER * max(float(np.median(left)), 0.01 * pixel)
    own = float(np.mean(free[used, 5] ** 2))
    new = sum(scatter(times, along) ** 2 for along in (moves - regressors @ fitted).T)
    excess = float(np.mean(left[used] ** 2)) - own
    return float(np.sqrt(max(excess, 0.0))), float(np.sqrt(max(new - own, 0.0)))
