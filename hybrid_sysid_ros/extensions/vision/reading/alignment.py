"""Alignment: the angle at which layers explain a picture best, by least squares with robust weights (compiled)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.extensions.vision.reading.layers import SATURATED, WHITE, Plane
from hybrid_sysid_ros.support.arrays import Array

STEPS, FIRST_STEPS = 12, 4  # of an alignment at most, and of that of a candidate
SETTLED = 0.01  # pixels at the sprite's end: a step that ends an alignment
FARTHEST = 2.0  # pixels at the sprite's end, in one step
CAPPED = 40.0  # counts: a larger difference says no more to a scan
BISQUARE = 4.685  # deviations, beyond which a difference has no weight (Beaton and Tukey 1974): 95 % efficient
BINS = 512  # of the differences' histogram, half a count each
TRIED = 3  # candidates of a scan
Points = NDArray[np.float32]
"""Texels (points, 2): u and v from the pivot [pixels]."""


@inner
def point(
    picture: NDArray[np.uint8],
    background: Plane,
    alpha: Plane,
    texture: Plane,
    first: tuple[float, float],
    pivot: tuple[float, float],
    gains: Array,
    c: float,
    s: float,
    u: float,
    v: float,
) -> tuple[float, float, float, float, int]:
    """Difference of the pixel nearest to a texel from the layers [counts], how fast the layers change there with the
    angle [counts/rad] and with the sprite's place along x and y [counts/pixel], and its row, -1 outside of the picture.
    A pixel shows no more than WHITE: what is brighter changes nothing there.
    """
    x, y = math.floor(pivot[0] + u * c - v * s + 0.5), math.floor(pivot[1] + u * s + v * c + 0.5)
    if x < 0 or y < 0 or x >= picture.shape[1] or y >= picture.shape[0]:
        return 0.0, 0.0, 0.0, 0.0, -1
    dx, dy = x - pivot[0], y - pivot[1]
    across, down = dx * c + dy * s, -dx * s + dy * c
    k, i = math.floor(across - first[0]), math.floor(down - first[1])
    if k < 0 or i < 0 or k >= alpha.shape[1] - 1 or i >= alpha.shape[0] - 1:
        return 0.0, 0.0, 0.0, 0.0, -1
    right, low = across - first[0] - k, down - first[1] - i
    behind, gain = background[y, x], gains[y]
    # what the layers show at the four texels around: B (1 - a) + T
    a = behind * (1.0 - alpha[i, k]) + texture[i, k]
    b = behind * (1.0 - alpha[i, k + 1]) + texture[i, k + 1]
    d = behind * (1.0 - alpha[i + 1, k]) + texture[i + 1, k]
    e = behind * (1.0 - alpha[i + 1, k + 1]) + texture[i + 1, k + 1]
    shown = (1.0 - low) * ((1.0 - right) * a + right * b) + low * ((1.0 - right) * d + right * e)
    if gain * shown > WHITE:
        return picture[y, x] - WHITE, 0.0, 0.0, 0.0, y
    by_u = (1.0 - low) * (b - a) + low * (e - d)
    by_v = (1.0 - right) * (d - a) + right * (e - b)
    # du / dangle = -v, dv / dangle = u; moved along x, u falls by c and v rises by s
    turning, along, down = by_v * across - by_u * down, by_v * s - by_u * c, -by_u * s - by_v * c
    return picture[y, x] - gain * shown, gain * turning, gain * along, gain * down, y


@inner
def scanned(
    picture: NDArray[np.uint8], background: Plane, alpha: Plane, texture: Plane, first: tuple[float, float],
    pivot: tuple[float, float], gains: Array, points: Points, angle: float,
) -> float:  # fmt: skip
    """Mean capped difference of the layers at an angle [counts]."""
    c, s, total, count = math.cos(angle), -math.sin(angle), 0.0, 0
    for k in range(points.shape[0]):
        difference, _, _, _, row = point(
            picture, background, alpha, texture, first, pivot, gains, c, s, points[k, 0], points[k, 1]
        )
        if row >= 0:
            total += min(abs(difference), CAPPED)
            count += 1
    return total / count if count > points.shape[0] // 4 else CAPPED


@inner
def aligned(
    picture: NDArray[np.uint8], background: Plane, alpha: Plane, texture: Plane, first: tuple[float, float],
    pivot: tuple[float, float], gains: Array, points: Points, angle: float, reach: float, steps: int, out: Array,
) -> None:  # fmt: skip
    """Gauss-Newton from an angle on, in so many steps at most. out: angle [rad], its variance, mean capped difference
    [counts], mean row, the share of the points that the layers explain, the deviation of most of them [counts], and by
    how much the angle is another one where each edge is off by a count, all to one side [rad/count].

    The variance is that of correlated differences, as codecs make them: points of one block of texels count as one
    (White 1980, clustered), and those of two or four blocks where that is more. Its curvature is that of the robust
    weights' own slope (Huber 1967), which is less than that of Gauss-Newton.
    """
    count = points.shape[0]
    width = 16.0 * max(1.0, reach / 320.0)
    blocks = 2 * int(reach / width) + 4
    scores = np.empty(blocks)
    histogram = np.zeros(BINS, dtype=np.int64)
    deviation = 0.0
    out[1:] = np.nan
    for step in range(steps):
        c, s = math.cos(angle), -math.sin(angle)
        limit = BISQUARE * deviation
        gradient = curvature = bend = rows = total = weights = one_sided = 0.0
        scores[:], histogram[:], used, informative = 0.0, 0, 0, 0
        for k in range(count):
            difference, slope, _, _, row = point(
                picture, background, alpha, texture, first, pivot, gains, c, s, points[k, 0], points[k, 1]
            )
            if row < 0:
                continue
            used += 1
            size = abs(difference)
            if slope != 0.0:  # what is white differs by nothing
                informative += 1
                histogram[min(int(2.0 * size), BINS - 1)] += 1
            total += min(size, CAPPED)
            weight = _weight(size, limit)
            if weight == 0.0:
                continue
            gradient += weight * difference * slope
            curvature += weight * slope * slope
            bend += _weight_slope(size, limit) * slope * slope
            rows += weight * slope * slope * row
            weights += weight
            one_sided += weight * abs(slope)
            scores[int(points[k, 0] / width + blocks / 2)] += weight * difference * slope
        if used < count // 4 or not curvature > 0.0:
            return
        deviation = max(_median(histogram, informative) / 0.6745, 0.7)
        move = gradient / curvature
        out[0], out[2], out[3], out[4], out[5] = angle, total / used, rows / curvature, weights / used, deviation
        out[1] = _clustered(scores) / bend**2 if bend > 0.0 else np.nan
        out[6] = one_sided / curvature
        if step > 1 and abs(move) * reach < SETTLED:
            break
        most = FARTHEST / reach
        angle += min(max(move, -most), most)


@inner
def _weight(size: float, limit: float) -> float:
    """Of a difference [counts]: the bisquare that ends at a limit, or before one is known, at 0, Cauchy's."""
    if limit == 0.0:
        return 1.0 / (1.0 + (size / 10.0) ** 2)
    return (1.0 - (size / limit) ** 2) ** 2 if size < limit else 0.0


@inner
def _weight_slope(size: float, limit: float) -> float:
    """How fast a weighted difference grows with the difference itself [counts]; below 0 where it is cut off."""
    if limit == 0.0:
        square = (size / 10.0) ** 2
        return (1.0 - square) / (1.0 + square) ** 2
    square = (size / limit) ** 2
    return (1.0 - square) * (1.0 - 5.0 * square) if square < 1.0 else 0.0


@inner
def _clustered(scores: Array) -> float:
    """Variance of the sum of scores (blocks,): the largest of those by which one to eight blocks go together."""
    most = 0.0
    for merged in (1, 2, 4, 8):
        total, groups = 0.0, 0
        for first in range(0, scores.shape[0], merged):
            score = 0.0
            for k in range(first, min(first + merged, scores.shape[0])):
                score += scores[k]
            if score != 0.0:
                total += score**2
                groups += 1
        if groups > 1:
            most = max(most, total * groups / (groups - 1))
    return most


@inner
def _median(histogram: NDArray[np.int64], count: int) -> float:
    """Of the differences that a histogram counts [counts]."""
    seen = 0
    for k in range(BINS):
        if 2 * (seen + histogram[k]) >= count:
            return 0.5 * (k + (0.5 * count - seen) / max(histogram[k], 1))
        seen += histogram[k]
    return 0.5 * BINS


@inner
def light(picture: NDArray[np.uint8], background: Plane, columns: NDArray[np.int32], gains: Array) -> None:
    """The gain of each row, by the median of what its still pixels show beside the background: columns (rows, pixels),
    -1 for none. It is smoothed over neighbours, as light changes slowly over rows, and interpolated where none stands.
    """
    height = picture.shape[0]
    ratios, raw = np.empty(columns.shape[1]), np.full(height, np.nan)
    for y in range(height):
        found = 0
        for k in range(columns.shape[1]):
            x = columns[y, k]
            if x >= 0 and picture[y, x] < SATURATED:
                ratios[found] = picture[y, x] / background[y, x]
                found += 1
        if found > 4:
            few = ratios[:found]
            few.sort()
            raw[y] = 0.5 * (few[found // 2] + few[(found - 1) // 2])
    half = max(height // 60, 1)
    for y in range(height):
        total = weights = 0.0
        for near in range(max(y - half, 0), min(y + half + 1, height)):
            if raw[near] == raw[near]:
                weight = half + 1.0 - abs(near - y)
                total += weight * raw[near]
                weights += weight
        gains[y] = total / weights if weights > 0.0 else np.nan
    known = np.flatnonzero(np.isfinite(gains))
    gains[:] = np.interp(np.arange(height), known, gains[known]) if known.size else np.ones(height)


@kernel
def read_angle(
    picture: NDArray[np.uint8], background: Plane, alpha: Plane, texture: Plane, first: tuple[float, float],
    pivot: tuple[float, float], columns: NDArray[np.int32], points: Points, few: Points, angles: Array, reach: float,
    gains: Array, out: Array,
) -> None:  # fmt: skip
    """The angle of a picture: the light by the still pixels, a scan of ``angles`` with a ``few`` points, alignment of
    its best candidates, and of the best of these with all points. out: see :func:`aligned`.
    """
    light(picture, background, columns, gains)
    costs = np.empty(angles.shape[0])
    for k in range(angles.shape[0]):
        costs[k] = scanned(picture, background, alpha, texture, first, pivot, gains, few, angles[k])
    best, least = angles[np.argmin(costs)], 1e9
    spread = max(angles.shape[0] // 40, 1)
    for _ in range(min(TRIED, angles.shape[0])):
        k = int(np.argmin(costs))
        aligned(picture, background, alpha, texture, first, pivot, gains, few, angles[k], reach, FIRST_STEPS, out)
        if out[2] < least:
            best, least = out[0], out[2]
        costs[max(k - spread, 0) : k + spread + 1] = 1e9
    aligned(picture, background, alpha, texture, first, pivot, gains, points, best, reach, STEPS, out)


@kernel
def align_freely(
    picture: NDArray[np.uint8], background: Plane, alpha: Plane, texture: Plane, first: tuple[float, float],
    pivot: tuple[float, float], gains: Array, points: Points, angle: float, reach: float, out: Array,
) -> None:  # fmt: skip
    """Alignment from a known angle on over angle and place together. out: angle [rad] and place beside the pivot
    [pixels], their variances, and their mean row; the variances are those of :func:`aligned`.
    """
    width = 16.0 * max(1.0, reach / 320.0)
    blocks = 2 * int(reach / width) + 4
    scores, normal, gradient = np.empty((blocks, 3)), np.empty((3, 3)), np.empty(3)
    histogram, slopes, beside, deviation = np.zeros(BINS, dtype=np.int64), np.empty(3), np.zeros(2), 0.0
    rows = np.empty(3)
    out[:] = np.nan
    for step in range(STEPS):
        c, s = math.cos(angle), -math.sin(angle)
        limit = BISQUARE * deviation
        scores[:], normal[:], gradient[:], histogram[:], rows[:] = 0.0, 0.0, 0.0, 0, 0.0
        used = informative = 0
        bend = 0.0
        place = (pivot[0] + beside[0], pivot[1] + beside[1])
        for k in range(points.shape[0]):
            difference, slopes[0], slopes[1], slopes[2], row = point(
                picture, background, alpha, texture, first, place, gains, c, s, points[k, 0], points[k, 1]
            )
            if row < 0:
                continue
            used += 1
            size = abs(difference)
            if slopes[0] != 0.0:
                informative += 1
                histogram[min(int(2.0 * size), BINS - 1)] += 1
            weight = _weight(size, limit)
            if weight == 0.0:
                continue
            bend += _weight_slope(size, limit) * slopes[0] ** 2
            block = int(points[k, 0] / width + blocks / 2)
            for i in range(3):
                rows[i] += weight * slopes[i] * slopes[0] * row
                gradient[i] += weight * difference * slopes[i]
                scores[block, i] += weight * difference * slopes[i]
                for j in range(3):
                    normal[i, j] += weight * slopes[i] * slopes[j]
        if used < points.shape[0] // 4 or not min(normal[0, 0], normal[1, 1], normal[2, 2]) > 0.0:
            return
        steeper = normal[0, 0] / bend if bend > 0.0 else np.nan
        for i in range(3):
            normal[i, i] *= 1.0 + 1e-6
        inverse = np.linalg.inv(normal)
        move = inverse @ gradient
        spread = scores @ inverse
        # a joint that turns is turned by as much more or less in each row, and so much is each row's part of the angle
        out[0], out[1], out[2] = angle, beside[0], beside[1]
        out[6] = inverse[0, 0] * rows[0] + inverse[0, 1] * rows[1] + inverse[0, 2] * rows[2]
        for i in range(3):
            out[3 + i] = _clustered(spread[:, i]) * steeper**2
        deviation = max(_median(histogram, informative) / 0.6745, 0.7)
        if step > 1 and abs(move[0]) * reach + abs(move[1]) + abs(move[2]) < SETTLED:
            return
        most = FARTHEST / reach
        angle += min(max(move[0], -most), most)
        for i in range(2):
            beside[i] += min(max(move[1 + i], -FARTHEST), FARTHEST)


@kernel
def align_from(
    picture: NDArray[np.uint8], background: Plane, alpha: Plane, texture: Plane, first: tuple[float, float],
    pivot: tuple[float, float], gains: Array, points: Points, angle: float, reach: float, out: Array,
) -> None:  # fmt: skip
    """Alignment from a known angle on."""
    aligned(picture, background, alpha, texture, first, pivot, gains, points, angle, reach, STEPS, out)
