"""Regression of layers: what films say of each pixel and each texel where the angles are known (compiled)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.extensions.vision.reading.layers import SATURATED, Plane
from hybrid_sysid_ros.support.arrays import Array

Film = NDArray[np.uint8]
"""Pictures (pictures, rows, columns)."""
FEWEST = 0.2  # share of the pictures that must show a texel
BRIGHT = 60.0  # counts, above which a difference counts no more
FAINT = 2.0  # counts, by which it must differ at least
KEPT = 0.6
"""Share of the pictures that tell a texel or a pixel, those that go together best: so many show no passer-by there."""
OF_KEPT = 0.463  # rms of the smallest KEPT of normal differences, in deviations of all
CONCENTRATED = 3  # steps of concentration
PLAIN = 1.5  # deviations of the noise, below which what is left of least squares has no outliers in it
SURE = 3.0  # deviations, within which differences count in the end
WHOLE = 0.9  # of a pixel's background, seen in a picture that tells its median
HIDDEN = 0.05  # share of a pixel's background that must be seen, summed over the pictures, to be known


@kernel
def median_picture(film: Film, lights: Array) -> Plane:
    """Median of each pixel over the pictures, their light (pictures,) taken out, (rows, columns)."""
    count, rows, columns = film.shape
    found, values = np.empty((rows, columns), dtype=np.float32), np.empty(count)
    for y in range(rows):
        for x in range(columns):
            for k in range(count):
                values[k] = film[k, y, x] / lights[k]
            found[y, x] = np.partition(values, count // 2)[count // 2]
    return found


@kernel
def polar_maps(
    film: Film, lights: Array, still: Plane, pivot: tuple[float, float], shape: tuple[int, int], radius: float,
    threshold: float, sign: float,
) -> NDArray[np.float32]:  # fmt: skip
    """How much brighter (sign 1) or darker (-1) than the still picture each picture is, by distance from the pivot and
    by direction, (pictures, rings, directions); directions go clockwise with y down.
    """
    count, rows, columns = film.shape
    rings, directions = shape
    maps = np.zeros((count, rings, directions), dtype=np.float32)
    for y in range(rows):
        for x in range(columns):
            dx, dy = x - pivot[0], y - pivot[1]
            ring = int(math.hypot(dx, dy) / radius * rings)
            if ring >= rings or ring * radius < 0.04 * radius * rings:
                continue
            direction = int((math.atan2(dy, dx) / (2.0 * math.pi) + 0.5) * directions) % directions
            for k in range(count):
                more = sign * (film[k, y, x] / lights[k] - still[y, x])
                if more > threshold:
                    maps[k, ring, direction] += min(more, BRIGHT)
    return maps


@inner
def line(seen: Array, behind: Array, noise: float, apart: Array) -> tuple[float, float]:
    """Slope, from 0 to 1, and level of seen = slope behind + level, (n,) each. noise: of ``seen``; apart: room for n.

    Least squares where that explains all; otherwise least trimmed squares (Rousseeuw 1984): concentration steps from
    the two ways in which a texel may be, hiding and clear, then least squares over all that lies near.
    """
    slope, level, total = _fitted(seen, behind, 0.0, 0.0, np.inf, noise)
    count = seen.shape[0]
    if total < count * (PLAIN * noise) ** 2:
        return slope, level
    kept, least = max(int(KEPT * count), 1), np.inf
    for start in (0.0, 1.0):
        tried, height = start, _middle(seen, behind, start, apart)
        total = 0.0
        for _ in range(CONCENTRATED):
            for n in range(count):
                apart[n] = abs(seen[n] - tried * behind[n] - height)
            limit = np.partition(apart[:count], kept - 1)[kept - 1]
            tried, height, total = _fitted(seen, behind, tried, height, limit, noise)
        if total < least:
            least, slope, level = total, tried, height
    deviation = max(math.sqrt(least / kept) / OF_KEPT, noise)
    slope, level, _ = _fitted(seen, behind, slope, level, SURE * deviation, noise)
    return slope, level


@inner
def _middle(seen: Array, behind: Array, slope: float, apart: Array) -> float:
    """Median of what is left of ``seen``."""
    count = seen.shape[0]
    for n in range(count):
        apart[n] = seen[n] - slope * behind[n]
    return np.partition(apart[:count], count // 2)[count // 2]  # type: ignore[no-any-return]


@inner
def _fitted(
    seen: Array, behind: Array, slope: float, level: float, limit: float, noise: float
) -> tuple[float, float, float]:
    """Slope and level anew, by least squares over what lies within ``limit`` of the line, and the sum of the squares
    that are left of that.
    """
    weights = sum_b = sum_i = bb = bi = ii = 0.0
    for n in range(seen.shape[0]):
        if abs(seen[n] - slope * behind[n] - level) <= limit:
            weights += 1.0
            sum_b += behind[n]
            sum_i += seen[n]
            bb += behind[n] ** 2
            bi += behind[n] * seen[n]
            ii += seen[n] ** 2
    mean_b, mean_i = sum_b / weights, sum_i / weights
    bb, bi = max(bb - weights * mean_b**2, 0.0), bi - weights * mean_b * mean_i
    ii = max(ii - weights * mean_i**2, 0.0)
    slope = min(max(bi / (bb + weights * noise**2), 0.0), 1.0)
    return slope, mean_i - slope * mean_b, max(ii - 2.0 * slope * bi + slope**2 * bb, 0.0)


@kernel
def regress_texels(
    film: Film, gains: Array, angles: Array, background: Plane, pivot: tuple[float, float], first: tuple[float, float],
    wanted: NDArray[np.bool_], noise: float, alpha: Plane, texture: Plane,
) -> None:  # fmt: skip
    """I = B (1 - a) + T of each wanted texel (texels): a line through what is seen there against what is behind it.
    gains (pictures, rows).

    What the background explains alone is no sprite; where it never changes along the texel's way, the sprite hides it.
    """
    count, rows, columns = film.shape
    seen, behind, apart = np.empty(count), np.empty(count), np.empty(count)
    cosines, sines = np.cos(angles), -np.sin(angles)
    for i in range(wanted.shape[0]):
        for k in range(wanted.shape[1]):
            if not wanted[i, k]:
                continue
            u, v, used = first[0] + k, first[1] + i, 0
            for n in range(count):
                c, s = cosines[n], sines[n]
                x, y = pivot[0] + u * c - v * s, pivot[1] + u * s + v * c
                left, up = math.floor(x), math.floor(y)
                if left < 0 or up < 0 or left >= columns - 1 or up >= rows - 1:
                    continue
                right, down, picture = x - left, y - up, film[n]
                value = (1.0 - down) * ((1.0 - right) * picture[up, left] + right * picture[up, left + 1])
                value += down * ((1.0 - right) * picture[up + 1, left] + right * picture[up + 1, left + 1])
                plain = (1.0 - down) * ((1.0 - right) * background[up, left] + right * background[up, left + 1])
                plain += down * ((1.0 - right) * background[up + 1, left] + right * background[up + 1, left + 1])
                seen[used], behind[used] = value / gains[n, up], plain
                used += 1
            alpha[i, k] = texture[i, k] = 0.0
            if used < FEWEST * count:
                continue
            slope, level = line(seen[:used], behind[:used], noise, apart)
            for n in range(used):
                apart[n] = (seen[n] - behind[n]) ** 2
            kept = max(int(KEPT * used), 1)
            if np.mean(np.partition(apart[:used], kept - 1)[:kept]) > noise**2 + FAINT**2:
                alpha[i, k], texture[i, k] = 1.0 - slope, max(level, 0.0)


@kernel
def regress_background(
    film: Film, gains: Array, angles: Array, alpha: Plane, texture: Plane, pivot: tuple[float, float],
    first: tuple[float, float], swept: NDArray[np.bool_], noise: float, background: Plane,
) -> None:  # fmt: skip
    """B = sum (1 - a) (I - T) / sum (1 - a)^2 of each swept pixel (rows, columns), but where it is hidden always; from
    the median of what shows it whole on, without what lies far from that.
    """
    count, rows, columns = film.shape
    values, weights, whole = np.empty(count), np.empty(count), np.empty(count)
    cosines, sines = np.cos(angles), -np.sin(angles)
    for y in range(rows):
        for x in range(columns):
            if not swept[y, x]:
                continue
            shown = 0
            dx, dy = x - pivot[0], y - pivot[1]
            for n in range(count):
                c, s = cosines[n], sines[n]
                u, v = dx * c + dy * s - first[0], -dx * s + dy * c - first[1]
                k, i = math.floor(u), math.floor(v)
                a = t = 0.0
                if k >= 0 and i >= 0 and k < alpha.shape[1] - 1 and i < alpha.shape[0] - 1:
                    right, down = u - k, v - i
                    a = (1.0 - down) * ((1.0 - right) * alpha[i, k] + right * alpha[i, k + 1])
                    a += down * ((1.0 - right) * alpha[i + 1, k] + right * alpha[i + 1, k + 1])
                    t = (1.0 - down) * ((1.0 - right) * texture[i, k] + right * texture[i, k + 1])
                    t += down * ((1.0 - right) * texture[i + 1, k] + right * texture[i + 1, k + 1])
                values[n], weights[n] = film[n, y, x] / gains[n, y] - t, 1.0 - a
                if a < 1.0 - WHOLE:
                    whole[shown] = values[n] / weights[n]
                    shown += 1
            limit, found = 1e9, background[y, x]
            if shown > HIDDEN * count:
                found = np.partition(whole[:shown], shown // 2)[shown // 2]
                for n in range(shown):
                    whole[n] = abs(whole[n] - found)
                limit = SURE * max(np.partition(whole[:shown], shown // 2)[shown // 2] / 0.6745, noise)
            for _ in range(2):
                above = below = 0.0
                for n in range(count):
                    if abs(values[n] - weights[n] * found) <= limit:
                        above += weights[n] * values[n]
                        below += weights[n] ** 2
                if below < HIDDEN * count:
                    break
                found = above / below
            background[y, x] = found


@kernel
def sharpen(
    film: Film, gains: Array, angles: Array, background: Plane, pivot: tuple[float, float], first: tuple[float, float],
    wanted: NDArray[np.bool_], noise: float, passes: int, alpha: Plane, texture: Plane,
) -> None:  # fmt: skip
    """Improve the sprite so that what is drawn between its texels, not each texel alone, is what pixels show: what a
    regression of texels blurs, as every pixel lies between some, comes back (simultaneous iterative reconstruction).
    """
    count, rows, columns = film.shape
    height, width = alpha.shape
    for _ in range(passes):
        sums = np.zeros((height, width, 5))  # w B B, w B, w, w B r, w r
        for n in range(count):
            c, s = math.cos(angles[n]), -math.sin(angles[n])
            for p in range(height):
                for o in range(width):
                    if not wanted[p, o]:
                        continue
                    u, v = first[0] + o, first[1] + p
                    x = math.floor(pivot[0] + u * c - v * s + 0.5)
                    y = math.floor(pivot[1] + u * s + v * c + 0.5)
                    if x < 0 or y < 0 or x >= columns or y >= rows:
                        continue
                    dx, dy = x - pivot[0], y - pivot[1]
                    across, down = dx * c + dy * s - first[0], -dx * s + dy * c - first[1]
                    k, i = math.floor(across), math.floor(down)
                    if k < 0 or i < 0 or k >= width - 1 or i >= height - 1:
                        continue
                    right, low, b = across - k, down - i, background[y, x]
                    w00, w01 = (1.0 - low) * (1.0 - right), (1.0 - low) * right
                    w10, w11 = low * (1.0 - right), low * right
                    a = w00 * alpha[i, k] + w01 * alpha[i, k + 1] + w10 * alpha[i + 1, k] + w11 * alpha[i + 1, k + 1]
                    t = w00 * texture[i, k] + w01 * texture[i, k + 1]
                    t += w10 * texture[i + 1, k] + w11 * texture[i + 1, k + 1]
                    left = film[n, y, x] / gains[n, y] - b * (1.0 - a) - t
                    if left < 0.0 and film[n, y, x] >= SATURATED:
                        continue  # it may have been as bright as that
                    sure = 1.0 / (1.0 + (left / (10.0 * noise)) ** 2)
                    for j in range(4):
                        weight = sure * (w00 if j == 0 else w01 if j == 1 else w10 if j == 2 else w11)
                        cell = sums[i + j // 2, k + j % 2]
                        cell[0] += weight * b * b
                        cell[1] += weight * b
                        cell[2] += weight
                        cell[3] += weight * b * left
                        cell[4] += weight * left
        for i in range(height):
            for k in range(width):
                cell = sums[i, k]
                if not wanted[i, k] or cell[2] < FEWEST * count:
                    continue
                # left = -B da + dT, by least squares over the texel's pixels; da only as far as B tells it
                variance = cell[0] - cell[1] ** 2 / cell[2] + 4.0 * cell[2] * noise**2
                da = -(cell[3] - cell[1] * cell[4] / cell[2]) / variance
                before = alpha[i, k]
                alpha[i, k] = min(max(before + da, 0.0), 1.0)
                dt = (cell[4] + cell[1] * (alpha[i, k] - before)) / cell[2]
                texture[i, k] = max(texture[i, k] + dt, 0.0)
