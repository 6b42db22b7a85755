"""Exposure: a picture as a rolling shutter takes it, every row the mean over its own interval of time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.support.arrays import Array

SMEAR = 0.6  # pixels that the sprite's end moves from one instant of an exposure to the next, at most
MOST_INSTANTS = 64


def instants_of(times: Array, angles: Array, begins: Array, exposure: float, reach: float) -> int:
    """How many instants of an exposure [s] a picture needs: rows begin at ``begins`` (rows,) [s], the sprite reaches
    ``reach`` [pixels], and its angles [rad] at times [s] are (n,).
    """
    first, last = np.searchsorted(times, [begins[0], begins[-1] + exposure])
    seen = angles[max(first - 1, 0) : last + 2]
    moved = float(seen.max() - seen.min()) if seen.size else 0.0
    return min(max(math.ceil(reach * moved / SMEAR), 1), MOST_INSTANTS)


@kernel
def expose(
    background: Array,
    alpha: Array,
    texture: Array,
    place: tuple[float, float, float],
    pivot: tuple[float, float],
    roll: float,
    times: Array,
    angles: Array,
    begins: Array,
    exposure: float,
    instants: int,
    gains: Array,
    lamp: Array,
    lit: Array,
    noise: NDArray[np.float32],
    offsets: NDArray[np.int64],
    picture: NDArray[np.uint8],
) -> None:
    """I = gain(row) mean over the exposure of [B (1 - a) + T] + noise, in counts.

    background (rows, columns), alpha and texture (texels of the sprite, whose first is at ``place[:2]`` from the pivot
    in pixels, ``place[2]`` apart), lamp (rows, columns) with the share ``lit`` (rows,) of the exposure: from 0 to 1.
    pivot [pixels]. times, angles (instants,) [s], [rad]: the motion, on straight lines. begins (rows,) [s]: when
    a row's exposure begins. noise: a ring of numbers [counts], of which a row begins at ``offsets`` (rows,).
    """
    rows, columns = background.shape
    line, weight = np.empty(columns), 1.0 / instants
    cosines, sines = np.empty(instants), np.empty(instants)
    for y in range(rows):
        dy = y - pivot[1]
        first, last = columns, 0
        for j in range(instants):
            angle = _at(begins[y] + (j + 0.5) * exposure * weight, times, angles) + roll
            cosines[j], sines[j] = math.cos(angle), -math.sin(angle)
            low, high = _reach(dy, cosines[j], sines[j], place, alpha.shape)
            first = min(first, max(math.floor(low + pivot[0]), 0))
            last = max(last, min(math.ceil(high + pivot[0]) + 1, columns))
        line[:] = background[y]
        for x in range(first, last):
            total, behind = 0.0, background[y, x]
            for j in range(instants):
                dx, c, s = x - pivot[0], cosines[j], sines[j]
                u = (dx * c + dy * s - place[0]) / place[2]
                v = (-dx * s + dy * c - place[1]) / place[2]
                k, i = math.floor(u), math.floor(v)
                if k < 0 or i < 0 or k >= alpha.shape[1] - 1 or i >= alpha.shape[0] - 1:
                    total += behind
                    continue
                right, down = u - k, v - i
                a = (1.0 - down) * ((1.0 - right) * alpha[i, k] + right * alpha[i, k + 1])
                a += down * ((1.0 - right) * alpha[i + 1, k] + right * alpha[i + 1, k + 1])
                t = (1.0 - down) * ((1.0 - right) * texture[i, k] + right * texture[i, k + 1])
                t += down * ((1.0 - right) * texture[i + 1, k] + right * texture[i + 1, k + 1])
                total += behind * (1.0 - a) + t
            line[x] = total * weight
        at = offsets[y]
        for x in range(columns):
            counts = 255.0 * gains[y] * (line[x] + lit[y] * lamp[y, x]) + noise[at + x]
            picture[y, x] = int(min(max(counts + 0.5, 0.0), 255.0))


@inner
def _at(time: float, times: Array, angles: Array) -> float:
    """The angle at a time, on straight lines, beyond the ends as there."""
    k = np.searchsorted(times, time)
    if k == 0:
        return angles[0]  # type: ignore[no-any-return]
    if k == times.shape[0]:
        return angles[k - 1]  # type: ignore[no-any-return]
    share = (time - times[k - 1]) / (times[k] - times[k - 1])
    return (1.0 - share) * angles[k - 1] + share * angles[k]  # type: ignore[no-any-return]


@inner
def _reach(
    dy: float, c: float, s: float, place: tuple[float, float, float], shape: tuple[int, int]
) -> tuple[float, float]:
    """Lowest and highest dx of a row that the sprite's texels reach."""
    low, high = -1e9, 1e9
    # u = dx c + dy s, v = -dx s + dy c
    for slope, level, begin, count in ((c, dy * s, place[0], shape[1]), (-s, dy * c, place[1], shape[0])):
        end = begin + (count - 1) * place[2]
        if abs(slope) < 1e-9:
            if level < begin or level > end:
                return 1e9, -1e9
            continue
        one, other = (begin - level) / slope, (end - level) / slope
        low, high = max(low, min(one, other)), min(high, max(one, other))
    if low > high:
        return 1e9, -1e9
    return low, high
