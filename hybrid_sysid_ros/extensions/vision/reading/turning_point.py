"""Turning point: the place about which something turns in a film, where nothing is known of it (OpenCV)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.scene import scene_of, with_pivot
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.extras import extra

COLUMNS = 320  # of the pictures that are compared
SMOOTHED = 1.5  # pixels of these: deviation of the Gaussian window, within which brightness is linear in the place
PAIRS = 400  # at most
SPACING = 0.02  # s between them: in a shorter time little turns
CHANGED = 4.0  # times its noise that a pixel must change,
AGAIN = 0.1  # in this share of the pairs: what turns comes over its places again and again, who walks by comes once
UNSURE = 0.25  # pixels: as much may be left of the motion of a camera that is held by hand
FEWEST_PIXELS, FEWEST_PAIRS = 40, 12
LARGEST_TURN = 0.03  # rad between two pictures: brightness is not linear over more of the sprite's way
BISQUARE = 4.685  # deviations; see alignment.py
ROUNDS = 4
ELSEWHERE = 0.04  # widths: a pivot that is nearer is found from the scene's on; first angles bear about as much
OUTSIDE = 0.5  # widths beside the picture, beyond which something passes and does not turn


def with_turning_point(view: FilmView, rig: Rig) -> tuple[Rig, float]:
    """The rig with its scene's pivot where something turns in a film, where that is surely elsewhere, and how far
    [widths]; the same rig and 0 where it is not.
    """
    found, pivot = turning_point(view), np.array(scene_of(rig).pivot)
    if found is None:
        return rig, 0.0
    place, apart = found
    far = float(np.hypot(*(place - pivot)))
    sure = max(ELSEWHERE, 4.0 * float(np.hypot(*apart)))
    if not far > sure or not (np.abs(place - 0.5) < 0.5 + OUTSIDE).all():
        return rig, 0.0
    return with_pivot(rig, (float(place[0]), float(place[1]))), far


def turning_point(view: FilmView) -> tuple[Array, Array] | None:
    """Place about which what moves turns, and by how much two halves of the film differ in it, (2,) each [widths];
    None where too little turns.

    A turn by d about p moves the picture by d (p_y - y, x - p_x), so that brightness (constant along the way, Horn and
    Schunck 1981) changes by a linear function of d, d p_x and d p_y, which each two pictures tell by least squares
    with robust weights. Then p is what all of them have in common.
    """
    normals = _normals(view)
    if len(normals) < FEWEST_PAIRS:
        return None
    whole, *halves = (_common(part) for part in (normals, normals[::2], normals[1::2]))
    return whole, np.abs(halves[0] - halves[1])


def _normals(view: FilmView) -> NDArray[np.float64]:
    """Normal equations (pairs, 3, 4) of pairs of pictures, in d, d p_x and d p_y [pictures' widths]."""
    with extra("video"):
        import cv2
    times = np.array([time for time, _ in view.pictures()])
    apart = max(round(SPACING / max(float(np.median(np.diff(times))), 1e-9)), 1) if len(times) > 1 else 1
    every = max(len(times) // PAIRS, 1)
    stands = view.motion is None or view.motion.steady
    found, kept, often = list[_Change](), list[Picture](), np.zeros((1, 1))
    for number, (_, picture) in enumerate(view.pictures()):
        size = (COLUMNS, round(COLUMNS * picture.shape[0] / picture.shape[1]))
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        kept.append(np.asarray(cv2.GaussianBlur(small, (0, 0), SMOOTHED)))
        if len(kept) > apart:
            before = kept.pop(0)
            if number % every == 0:
                found.append(_change(before, kept[-1], 0.0 if stands else UNSURE))
                often = often + found[-1].where
    again = often > AGAIN * len(found)
    normals = [_normal(change, again) for change in found]
    return np.array([normal for normal in normals if normal is not None])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Change:
    """How brightness changes from one picture to another, where it does."""

    where: NDArray[np.bool_]
    """Pixels (rows, columns)."""
    slopes: NDArray[np.float32]
    """Of the change with d, d p_x and d p_y (pixels, 3)."""
    left: NDArray[np.float32]
    """The change (pixels,) [counts]."""
    noise: float


def _change(before: Picture, after: Picture, unsure: float) -> _Change:
    """unsure: pixels by which a picture may lie beside the other one, so that edges change that stand."""
    change, mean = after - before, 0.5 * (after + before)
    noise = max(float(np.median(np.abs(change))) / 0.6745, 0.2)
    by_y, by_x = np.gradient(mean)
    where = np.abs(change) > CHANGED * noise + unsure * np.hypot(by_x, by_y)
    y, x = np.nonzero(where)
    gx, gy = by_x[y, x] * COLUMNS, by_y[y, x] * COLUMNS
    slopes = np.column_stack([gy * (x + 0.5) / COLUMNS - gx * (y + 0.5) / COLUMNS, -gy, gx]).astype(np.float32)
    left = -change[y, x].astype(np.float32)
    return _Change(where=where, slopes=slopes, left=left, noise=noise)


def _normal(change: _Change, again: NDArray[np.bool_]) -> Array | None:
    """Of one pair (3, 4), by pixels that change again and again; None where these are few, or it turns too far."""
    used = again[change.where]
    if used.sum() < FEWEST_PIXELS:
        return None
    slopes, left = change.slopes[used].astype(np.float64), change.left[used].astype(np.float64)
    weights = np.ones(len(left))
    for _ in range(ROUNDS):
        normal = (weights[:, None] * slopes).T @ np.column_stack([slopes, left])
        turn = np.linalg.lstsq(normal[:, :3], normal[:, 3], rcond=1e-12)[0]
        size = np.abs(left - slopes @ turn)
        scale = max(float(np.median(size)) / 0.6745, change.noise)
        weights = np.maximum(1.0 - (size / (BISQUARE * scale)) ** 2, 0.0) ** 2
    return normal / scale**2 if abs(turn[0]) < LARGEST_TURN else None


def _common(normals: NDArray[np.float64]) -> Array:
    """The place (2,) that the pairs have in common: turns and place in turn, each by least squares."""
    turns = np.linalg.solve(normals[:, :, :3] + 1e-9 * np.eye(3), normals[:, :, 3:])[..., 0]
    place = np.median(turns[:, 1:] / turns[:, :1], axis=0)
    used = np.ones(len(normals), dtype=bool)
    for _ in range(50):
        along = np.column_stack([np.ones(len(normals)), np.tile(place, (len(normals), 1))])  # turn d: d (1, p)
        curved = np.einsum("ki,kij,kj->k", along, normals[:, :, :3], along)
        turn = np.einsum("ki,ki->k", along, normals[:, :, 3]) / np.maximum(curved, 1e-12)
        left = normals[:, 1:, 3] - turn[:, None] * normals[:, 1:, 0]
        heavy = turn[:, None, None] ** 2 * normals[:, 1:, 1:3]
        place = np.linalg.lstsq(heavy[used].sum(axis=0), (turn[:, None] * left)[used].sum(axis=0), rcond=1e-12)[0]
        off = np.hypot(*(turns[:, 1:] - turns[:, :1] * place).T)
        used = off <= 3.0 * np.median(off)
    return np.asarray(place)
