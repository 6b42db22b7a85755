"""The place about which a sprite turns, and how far, as its pictures show it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.support.arrays import Array

PIVOTED = 0.03  # pixels: as far as 50 pictures tell four numbers, each of which shows a place to .1
ONWARD = 0.9  # cosine between two steps, above which they go one way, and are not noise
LONGEST = 5.0  # times what the pictures show of a pivot's way, as layers that were learned about a wrong one hide most
TOGETHER = 0.5  # of angles that swing by 60 degrees to each side: those farther apart go all around
MOST_LIKE = 0.9  # correlation of a sway from one picture to the next that counts: of 160 pictures 8 tell then
FARTHEST_PIVOT = 0.05  # widths: how far the scene's pivot may be off, a standard deviation
FARTHEST_MOVE = 10.0  # pixels, of the sprite in one picture
SEEN_MOVE = 0.1  # pixels: how well a picture says where the sprite lies


class PivotWay:
    """Way of the pivot from round to round. Layers that were learned about a wrong pivot agree with it in part, so that
    pictures show only a share of the way; two rounds tell that share (a secant step, as Aitken's).
    """

    def __init__(self) -> None:
        self.left = math.inf
        """How far the sprite is still to be moved in the pictures, rms [pixels]."""
        self.wander = 0.0
        """How far it moves beside what turns about one pivot, rms, as most pictures show it [pixels],"""
        self.unsure = 0.0
        """and how uncertain a step is by that [pixels]."""
        self._before, self._longer, self._last = np.zeros(4), 1.0, math.inf

    def step(self, shown: Array, moves: Array, places: Array) -> Array:
        """The step to take (4,), by what the pictures show of it; moves: by how much a step moves the sprite in the
        pictures along each axis (2 pictures, 4), as a swing that is small tells not all of it; places (2 pictures,):
        where it lies in them, to which the step was fitted, so that what is left tells how sure that is.
        """
        before, now = moves @ self._before, moves @ shown
        left = places - now
        self.wander = math.sqrt(2.0) * float(np.median(np.abs(left))) / 0.6745
        self.unsure = self.wander * math.sqrt(len(shown) / len(now) * _repeated(left.reshape(2, -1)))
        along, both = float(now @ before), float(np.sqrt((now @ now) * (before @ before)))
        seen = float(np.sqrt(2.0 * np.mean(now**2)))
        if seen > PIVOTED and along > ONWARD * both:  # smaller steps go one way by chance
            share = (1.0 - along / float(before @ before)) / self._longer
            self._longer = max(min(1.0 / max(share, 1.0 / LONGEST), LONGEST), 1.0)
        else:
            self._longer = 1.0
        self._before = shown
        size = self._longer * seen
        self.left, self._last = max(size, self._last), size  # one small step may be its turning
        return self._longer * shown


class ScaleWay:
    """Way of the angles' scale from round to round: layers that were learned by angles which are too large agree with
    them in part, as what is always hidden near the pivot may be anything; two rounds tell the share, as of a pivot.
    """

    def __init__(self) -> None:
        self.left = math.inf
        """By how much the angles are still to grow, relative."""
        self._before, self._longer = 0.0, 1.0

    def step(self, given: Array, found: Array, *, alone: bool) -> Array:
        """The angles (pictures,) to learn the next layers by, where those that were learned by given ones found others
        [rad]; the same where they go all around, and have no scale. alone: whether the pivot has settled,
        as one beside its place has another scale.
        """
        (_, about, together), (middle, swings, _) = _swing(given), _swing(found)
        if together < TOGETHER:
            self.left = 0.0
            return found
        shown = float(about @ swings) / max(float(about @ about), 1e-12) - 1.0
        ratio = shown / self._before if shown * self._before > 0.0 else 1.0
        share = (1.0 - ratio) / self._longer if alone and ratio < 1.0 else 1.0
        self._longer = max(min(1.0 / max(share, 1.0 / LONGEST), LONGEST), 1.0)
        self._before, self.left = shown, self._longer * abs(shown)
        return np.asarray(middle + (1.0 + self._longer * shown) / (1.0 + shown) * swings)


def _swing(angles: Array) -> tuple[float, Array, float]:
    """Their middle and angles (pictures,) from there [rad], and how near together they are, 1 where they are one."""
    mean = np.mean(np.exp(1j * angles))
    middle = float(np.angle(mean))
    return middle, (angles - middle + math.pi) % (2.0 * math.pi) - math.pi, float(abs(mean))


def _repeated(left: Array) -> float:
    """Times as few as they are that differences (axes, pictures) tell, where each is like the one before, as of a hand
    that sways: (1 + r) / (1 - r) by their correlation r (Bartlett 1935).
    """
    like = float((left[:, 1:] * left[:, :-1]).sum() / max(float((left**2).sum()), 1e-12))
    like = min(max(like, 0.0), MOST_LIKE)
    return (1.0 + like) / (1.0 - like)


def pivoted(
    film: Film, gains: Array, angles: Array, layers: PictureLayers, reader: AngleReader, way: PivotWay
) -> tuple[PictureLayers, Array]:
    """The pivot moved to where the sprite turns about, and the angles (pictures,) about that: with a pivot p + e and
    texels u + d the sprite lies e + R(angle) d beside its place, and least squares over all pictures tells e, as far as
    the angles do.
    """
    free = [reader.read_freely(*each) for each in zip(film, angles, gains, strict=True)]
    known = np.array([math.isfinite(item.angle) for item in free])
    angles = np.where(known, [item.angle for item in free], angles)
    moves = np.clip(np.array([[item.x, item.y] for item in free])[known], -FARTHEST_MOVE, FARTHEST_MOVE)
    cos, sin = np.cos(angles[known]), -np.sin(angles[known])
    zero, one = np.zeros(len(cos)), np.ones(len(cos))
    along = np.column_stack([one, zero, cos, -sin])
    down = np.column_stack([zero, one, sin, cos])
    prior = np.zeros((2, 4))
    prior[0, 0] = prior[1, 1] = SEEN_MOVE / (FARTHEST_PIVOT * film.shape[2])
    regressors = np.vstack([along, down])
    lies = np.concatenate(moves.T)
    solved = np.linalg.lstsq(np.vstack([regressors, prior]), np.append(lies, [0.0, 0.0]), rcond=None)[0]
    step = way.step(solved, regressors, lies)
    places = (*layers.pivot, *layers.first)
    x, y, u, v = (place + float(move) for place, move in zip(places, step, strict=True))
    layers = replace(layers, geometry=replace(layers.geometry, pivot_x=x, pivot_y=y, first_u=u, first_v=v))
    nearer = AngleReader(layers)
    read = [nearer.read_near(*each).angle for each in zip(film, angles, gains, strict=True)]
    return layers, np.where(np.isfinite(read), read, angles)
