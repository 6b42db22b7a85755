"""Unused pictures: which pictures of a film tell no angle, or no true one, and why."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.support.arrays import Array

FROZEN, JUMP, BEYOND = 3, 1.0, 1.5
"""Pictures in a row that are one; pixels of the sprite's end, and times its largest change of speed: a camera hangs."""
DIM = 0.3  # of the light of most pictures: what is darker is left out
LEAP, RARE, LEAPS = 0.2, 3.0, 3
"""Share of all angles' range, and multiple of the turning points nine of ten of which are smaller, by which up to so
many pictures in a row are off all of those around them: they show somebody who walks by."""
UNLIKE, PLAINLY = 5.0, 10.0
"""Times as much as others, and counts, by which most pixels of a picture differ whose joint is not there."""
COPY, GOES_ON, COPIES = 0.25, 1.0, 0.1
"""Of what the sprite's end moves before and after it, by which it moves less in a picture that is a copy of the one
before; pixels that it moves there; and share of such pictures with which copies are also where the joint turns back."""


class Unused(Enum):
    """Why the angle of a picture is not used: what is said of a film with such pictures in a row, what is done about
    it, and what is said of single ones.
    """

    FROZEN = "stands still, frozen,", "cut it there", "those before once more, frozen or copied"
    SOFT = "is out of focus", "cut it there", "out of focus"
    TORN = (
        "is of a camera that shakes while its rows are read,", "put the camera on a tripod",
        "of a camera that shook while their rows were read",
    )  # fmt: skip
    DIM = "is black, or much darker than the rest,", "cut it there", "black, or much darker than the rest"
    CONTRADICTED = (
        "shows the joint elsewhere than the bag's sensor has it", "one of them is off: cut the film there if its "
        "pictures stand, or hide the joint", "off what the bag's sensor says",
    )  # fmt: skip
    HIDDEN = "shows no joint, or it is hidden,", "cut it there", "without an angle: hidden or of something else"

    def __init__(self, said: str, advice: str, note: str) -> None:
        self.said, self.advice, self.note = said, advice, note


def frozen_pictures(equal: NDArray[np.bool_], angles: Array, reach: float) -> NDArray[np.bool_]:
    """Pictures (pictures,) of a camera that hangs: those equal to the ones before, where the sprite's end jumps by JUMP
    before or after them; where it does not, the joint rests, and a codec repeats its picture. And those in which it
    stands, as a codec may write one picture otherwise each time, and then jumps BEYOND times as far as its speed ever
    changes from one picture to the next elsewhere.
    """
    found = np.zeros(len(equal), dtype=bool)
    steps = reach * _turn(np.diff(angles, prepend=np.nan))
    bends = np.append(np.abs(reach * _turn(np.diff(steps / reach))), np.nan)
    standing = [run for run in _runs(np.abs(steps) < COPY) if run[1] - run[0] >= FROZEN]
    elsewhere = np.delete(bends, [k for first, end in standing for k in (first - 1, end - 1, min(end, len(bends) - 1))])
    most = max(JUMP, BEYOND * float(np.nanmax(elsewhere, initial=0.0)))
    for first, end in _runs(equal):
        jumps = np.abs([steps[first - 1], *steps[end : end + 1]])
        if end - first >= FROZEN - 1 and np.nanmax(jumps, initial=0.0) > JUMP:
            found[first + FROZEN - 2 : end] = True
    for first, end in standing:
        if end < len(steps) and abs(steps[end]) > most:
            found[first + FROZEN - 2 : end] = True
    return found


def dim_pictures(lights: Array) -> NDArray[np.bool_]:
    """Pictures (pictures,) whose light has fallen by so much that a codec leaves little of them."""
    return np.asarray(lights < DIM * np.median(lights))


def copied_pictures(places: Array) -> NDArray[np.bool_]:
    """Pictures (pictures,) that are copies of those before them, one or two in a row, as where a film was written at a
    higher rate than it was taken at, or lost some: the joint stands in them, and goes on before and after them the same
    way. places: of the sprite's end [pixels].
    """
    steps = np.nan_to_num(np.diff(places, prepend=np.nan))
    pairs = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 2), 2)
    farther = np.where(np.abs(pairs[:, 0]) > np.abs(pairs[:, 1]), pairs[:, 0], pairs[:, 1])
    before, after = farther[:-3], farther[3:]
    least = np.minimum(np.abs(before), np.abs(after))
    stands, goes_on = np.abs(steps) < COPY * least, (before * after > 0.0) & (least > GOES_ON)
    surely = stands & goes_on
    return stands if surely.sum() >= max(COPIES * goes_on.sum(), 1.0) else surely


def unlike_pictures(differences: Array) -> NDArray[np.bool_]:
    """Pictures (pictures,) most pixels of which differ [counts] so much more from the layers than those of others that
    the joint is hidden, or gone; an alignment finds some angle there, too.
    """
    known = differences[np.isfinite(differences)]
    usual = float(np.median(known)) if len(known) else 0.0
    return differences > max(UNLIKE * usual, PLAINLY)


def leaping_pictures(angles: Array) -> NDArray[np.bool_]:
    """Pictures (pictures,), up to LEAPS in a row, whose angles are beyond the two before and the two after them by more
    than LEAP of the range of all angles, and by more than RARE times what turning points of the motion are.
    """
    found = np.zeros(len(angles), dtype=bool)
    for count in range(1, LEAPS + 1):
        usual = np.nan
        while len(known := np.flatnonzero(np.isfinite(angles) & ~found)) >= count + 4:
            windows = np.lib.stride_tricks.sliding_window_view(angles[known], count + 4)
            around, inside = windows[:, [0, 1, -2, -1]], windows[:, 2:-2]
            beyond = np.maximum(inside.min(axis=1) - around.max(axis=1), around.min(axis=1) - inside.max(axis=1))
            if np.isnan(usual):
                usual = float(np.quantile(beyond[beyond > 0.0], 0.9)) if (beyond > 0.0).any() else 0.0
            first = int(np.argmax(beyond))
            if not beyond[first] > max(LEAP * float(np.ptp(angles[known])), RARE * usual):
                break
            found[known[first + 2 : first + 2 + count]] = True
    return found


def _runs(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of what goes on without a gap."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def _turn(angles: Array) -> Array:
    """The shorter way round [rad]."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)
