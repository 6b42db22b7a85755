"""Synchronisation: where a film's time lies in a bag's, and the joint's position in the angles of the film."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from hybrid_sysid_ros.extensions.vision.reading.steadiness import scatter
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LOW_PASS = 15.0  # Hz, of both sensors before they are compared: hum aliases into a camera's 30 frames a second
GRID = 0.02  # s, of the search for the shift
FEWEST_SECONDS = 2.0  # that film and bag have in common
ALIKE = 0.9  # correlation, below which film and bag are of two motions
PACES = (1 / 8, 1 / 4, 1 / 2, 2.0, 4.0, 24 / 25, 25 / 24, 24 / 30, 30 / 24, 25 / 30, 30 / 25)
"""Times as fast as it was taken that a film may run by its own times: as slow or fast motion, or at another norm's."""
SURELY_ALIKE = 0.99  # correlation of a film's motion at one of these with the bag's
UNEVEN = 0.3  # pictures, by which times wander beside the bag's at most: those that are rounded to whole ones do so
STEPS = 30
BISQUARE = 4.685  # deviations; see alignment.py
CONTRADICTS = 10.0  # times as much as others differ, rms, by which film and bag differ by no chance, lens or codec
BLOCK = 1.0  # s, within which differences count as one
MOVED = 1e-9
SURELY = 3.0  # deviations of a mean square, by which film and bag differ by more than their noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Synchronisation:
    """bag time = shift + (1 + rate) film time;  position = scale angle + offset. With standard deviations."""

    shift: float
    """[s]"""
    rate: float
    """By which the film's clock is slow, 1e-6 are a ppm."""
    scale: float
    offset: float
    """[rad]"""
    deviations: Array
    """Of these four (4,)."""
    correlation: float
    """Of the two sensors' motions."""
    residual: float
    """Between them, rms [rad]."""
    used: NDArray[np.bool_]
    """Frames (frames,) that were compared: inside of the bag, and no outliers."""
    contradicted: NDArray[np.bool_]
    """Frames (frames,) that are off by more than CONTRADICTS times what those differ by."""
    bend: float
    """By which the film's values bend beside the bag's, rms [rad]; see :func:`bent`."""
    wander: float
    """By which the film's times run unevenly beside the bag's, rms [s]; see :func:`wandering`."""
    noise: float
    """Of the bag's values as they were compared, rms [rad]."""

    def time(self, film: Array) -> Array:
        """Times of a film in the bag's time [s]."""
        return np.asarray(self.shift + (1.0 + self.rate) * film)

    def position(self, angle: Array) -> Array:
        """Position of the joint [rad]."""
        return np.asarray(self.scale * angle + self.offset)

    def unexplained(self, deviations: Array) -> float:
        """By how much more film and bag differ, rms [rad], than the bag's noise and deviations of the film's values
        (frames,) explain; 0 where that is no more than chance makes.
        """
        own = float(np.mean((self.scale * deviations[self.used]) ** 2))
        found = self.residual**2 - self.noise**2 - own
        return math.sqrt(found) if found > SURELY * math.sqrt(2.0 / self.used.sum()) * self.residual**2 else 0.0


def synchronise(
    film: Array, angles: Array, bag: Array, positions: Array, *, exposure: float = 0.0, near: float | None = None
) -> Synchronisation:
    """Shift, rate, scale and offset between the angles (frames,) [rad] that a film shows at its times and the positions
    (samples,) [rad] that a bag has at its own, uniform times, both [s]. Frames without an angle are NaN.

    exposure [s]: of the film, over which positions are averaged, as a picture's angle is. near: a shift to look around,
    as the lamp tells; without it everywhere. The noise of both is taken down by the same low-pass, without a delay;
    then least squares with robust weights over all four.

    Raises UserError where they have too little in common, are of two motions, or the film is mirrored, or its times
    are of another rate than it was taken at or run unevenly.
    """
    noise = _noise(bag, positions)
    positions = exposed(positions, bag, exposure)
    try:
        found = replace(_synchronised(film, angles, bag, positions, near), noise=noise)
    except UserError:
        if _at_pace(1.0, film, -angles, bag, positions)[0] > SURELY_ALIKE:
            raise UserError(
                "the film's angles go the other way than the bag's: it is mirrored, or the sensor counts the other way"
            ) from None
        correlation, pace = max(_at_pace(pace, film, angles, bag, positions) for pace in PACES)
        if correlation > SURELY_ALIKE:
            raise UserError(
                f"the film runs {pace:.3g} times as fast as the bag by its own times, which are of another rate than "
                "it was taken at: write it again with the true ones"
            ) from None
        raise
    if found.wander > UNEVEN * float(np.median(np.diff(film))):
        raise UserError(
            f"the film's times wander by {1e3 * found.wander:.0f} ms, rms, beside the bag's: has it pictures missing "
            "that were numbered instead of timed, or is it of a screen? Write it again with true times"
        )
    return found


def _at_pace(pace: float, film: Array, angles: Array, bag: Array, positions: Array) -> tuple[float, float]:
    """Correlation of two motions, 0 where they are not the same, with the film's times stretched by a pace, and the
    pace at which they are most alike near that one.
    """
    try:
        found = _synchronised(pace * film, angles, bag, positions, None)
    except UserError:
        return 0.0, pace
    return found.correlation, pace * (1.0 + found.rate)


def _synchronised(film: Array, angles: Array, bag: Array, positions: Array, near: float | None) -> Synchronisation:
    """See :func:`synchronise`."""
    known = np.isfinite(angles)
    if known.sum() < 10 or len(bag) < 10:
        raise UserError("too few frames or samples to compare the film with the bag")
    period = float(np.median(np.diff(bag)))
    smooth = CubicSpline(bag, low_passed(positions, period))
    seen = _evenly(film[known], angles[known])
    shift = _coarse(film[known], seen, smooth, bag, near)
    values, centre = np.array([shift, 0.0, 1.0, 0.0]), float(film[known].mean())
    seen_angles, times = seen, film[known]
    used = np.ones(len(times), dtype=bool)
    for _ in range(STEPS):
        at = values[0] + times + values[1] * (times - centre)
        inside = (at > bag[0] + 0.2) & (at < bag[-1] - 0.2)
        if np.ptp(at[inside]) < FEWEST_SECONDS if inside.any() else True:
            raise UserError(f"film and bag have less than {FEWEST_SECONDS:g} s in common")
        speed = smooth(at, 1)
        difference = values[2] * seen_angles + values[3] - smooth(at)
        scatter = max(float(np.median(np.abs(difference[inside]))) / 0.6745, 1e-6)
        weights = np.where(inside, np.maximum(1.0 - (difference / (BISQUARE * scatter)) ** 2, 0.0) ** 2, 0.0)
        used = weights > 0.0
        slopes = np.column_stack([-speed, -speed * (times - centre), seen_angles, np.ones(len(times))])
        size = np.maximum(np.sqrt((weights[:, None] * slopes**2).sum(axis=0)), 1e-12)
        scaled = slopes / size
        normal = (weights[:, None] * scaled).T @ scaled
        move = np.linalg.lstsq(normal, -(weights[:, None] * scaled).T @ difference, rcond=1e-12)[0] / size
        move[0] = np.clip(move[0], -GRID, GRID)
        values += move
        if abs(move[0]) + abs(move[1]) * np.ptp(times) < MOVED:
            break
    one, two = (values[2] * seen_angles)[used], smooth(values[0] + times + values[1] * (times - centre))[used]
    correlation = float(np.corrcoef(one, two)[0, 1])
    if not (correlation > ALIKE and values[2] > 0.0 and used.sum() > 0.5 * inside.sum()):
        raise UserError(
            f"the film's motion is not the bag's (correlation {correlation:.2f}): are they of one experiment, and "
            "its times true, without pictures missing that were numbered instead?"
        )
    blocks = ((times - times[0]) / BLOCK).astype(int)
    scores = np.zeros((blocks[-1] + 1, 4))
    np.add.at(scores, blocks, (weights * difference)[:, None] * scaled)
    inverse = np.linalg.pinv(normal, rcond=1e-12)
    covariance = inverse @ (scores.T @ scores) @ inverse / np.outer(size, size)
    # the shift is stated at film time 0: shift - rate * centre
    to_zero = np.eye(4)
    to_zero[0, 1] = -centre
    residual = float(np.sqrt(np.mean(difference[used] ** 2)))
    own = values[2] * angles[known] + values[3] - smooth(at)  # a low-pass spreads what is off over its neighbours
    contradicted = inside & (np.minimum(np.abs(difference), np.abs(own)) > CONTRADICTS * residual)
    of_frames = np.zeros((2, len(film)), dtype=bool)
    of_frames[:, known] = used, contradicted
    return Synchronisation(
        shift=float(values[0] - values[1] * centre),
        rate=float(values[1]),
        scale=float(values[2]),
        offset=float(values[3]),
        deviations=np.sqrt(np.diag(to_zero @ covariance @ to_zero.T)),
        correlation=correlation,
        residual=residual,
        used=of_frames[0],
        contradicted=of_frames[1],
        bend=bent(seen_angles, slopes, difference, blocks, used),
        wander=wandering(speed[inside], difference[inside]),
        noise=0.0,
    )


def bent(values: Array, slopes: Array, difference: Array, blocks: NDArray[np.int_], used: NDArray[np.bool_]) -> float:
    """By how much values (frames,) of a film are no linear function of a bag's, rms [rad]: what their squares and
    cubes explain of the difference (frames,) beyond the slopes (frames, 4) of what was fitted, in used frames.

    A camera that looks from the side, a lens and a sensor that is not linear do this. It is found twice, by every other
    block of time, and what both tell counts: noise does not.
    """
    even = (values - values.mean()) / max(float(np.ptp(values)), 1e-12)
    slopes = slopes / np.maximum(np.abs(slopes).max(axis=0), 1e-12)
    curves = np.column_stack([even**2, even**3])
    curves = curves - slopes @ np.linalg.lstsq(slopes, curves, rcond=1e-12)[0]
    regressors = np.column_stack([curves, slopes])
    one, two = (
        curves @ np.linalg.lstsq(regressors[half], difference[half], rcond=1e-9)[0][:2]
        for half in (used & (blocks % 2 == 0), used & (blocks % 2 == 1))
    )
    return float(np.sqrt(max(float(np.mean(one * two)), 0.0)))


def wandering(speed: Array, difference: Array) -> float:
    """By how much the times (frames,) of a film run unevenly, rms [s]: differences of what moves fast scatter by so
    much more than those of what moves slowly, by their medians, which single pictures do not change.
    """
    size = np.abs(speed)
    slow, fast = size <= np.quantile(size, 1 / 3), size >= np.quantile(size, 2 / 3)
    more = float(np.mean(speed[fast] ** 2) - np.mean(speed[slow] ** 2))
    one, two = (float(np.median(np.abs(difference[part]))) / 0.6745 for part in (slow, fast))
    return float(np.sqrt(max(two**2 - one**2, 0.0) / more)) if more > 0.0 else 0.0


def _noise(times: Array, values: Array) -> float:
    """What the low-pass leaves of the noise of samples (n,) at times [s], rms; their noise is white."""
    once: Array = np.zeros(len(values))
    once[len(values) // 2 : len(values) // 2 + 1] = 1.0
    left = float(np.linalg.norm(low_passed(once, float(np.median(np.diff(times)))))) if len(values) > 1 else 1.0
    return left * scatter(times, values, white=True)


def low_passed(values: Array, period: float) -> Array:
    """Samples of a period [s] without what is faster than LOW_PASS, and without a delay."""
    if 0.45 / period <= LOW_PASS:
        return values
    sections = butter(4, LOW_PASS, fs=1.0 / period, output="sos")
    return np.asarray(sosfiltfilt(sections, values, padlen=min(len(values) - 1, round(1.0 / period))))


def exposed(values: Array, times: Array, exposure: float) -> Array:
    """Means of samples at times (n,) [s] over an exposure [s] about each; the first and last ones stay in between."""
    if not exposure:
        return values
    area, half = CubicSpline(times, values).antiderivative(), exposure / 2.0
    low, high = np.maximum(times - half, times[0]), np.minimum(times + half, times[-1])
    return np.asarray((area(high) - area(low)) / (high - low))


def _evenly(times: Array, angles: Array) -> Array:
    """A camera's angles, as they are where it is as slow as the low-pass, which takes nothing of them then."""
    period = float(np.median(np.diff(times)))
    if 0.45 / period <= LOW_PASS:
        return angles
    even = np.arange(times[0], times[-1] + period / 2, period)
    return np.asarray(CubicSpline(even, low_passed(np.interp(even, times, angles), period))(times))


def _coarse(times: Array, angles: Array, smooth: CubicSpline, bag: Array, near: float | None) -> float:
    """The shift on a grid at which the two motions are most alike."""
    even = np.arange(times[0], times[-1], GRID)
    seen = np.interp(even, times, angles)
    there = np.arange(bag[0], bag[-1], GRID)
    positions = smooth(there)
    if min(np.ptp(seen), np.ptp(positions)) < 1e-6:
        raise UserError("nothing moves in the film, or in the bag: there is no time to be told by")
    least = min(len(seen), len(positions), max(round(FEWEST_SECONDS / GRID), min(len(seen), len(positions)) // 4))
    count = len(seen) + len(positions)
    size = 1 << (count - 1).bit_length()

    def sums(one: Array, other: Array) -> Array:
        """Over what overlaps, for each lag of ``one`` in ``other``."""
        product = np.fft.irfft(np.fft.rfft(other, size) * np.conj(np.fft.rfft(one, size)), size)
        return np.concatenate([product[-(len(seen) - 1) :], product[: len(positions)]])

    ones, others = np.ones(len(seen)), np.ones(len(positions))
    middle_a, middle_b = float(seen.mean()), float(positions.mean())
    a, b = seen - middle_a, positions - middle_b
    n = np.maximum(np.round(sums(ones, others)), 1.0)
    sa, sb = sums(a, others), sums(ones, b)
    saa, sbb, sab = sums(a * a, others), sums(ones, b * b), sums(a, b)
    va, vb = saa - sa * sa / n, sbb - sb * sb / n
    floor_a, floor_b = 0.05 * np.var(a) * n, 0.05 * np.var(b) * n
    score = np.where(n >= least, (sab - sa * sb / n) / np.sqrt(np.maximum(va, floor_a) * np.maximum(vb, floor_b)), -1.0)
    lags = np.arange(-(len(seen) - 1), len(positions)) * GRID
    shifts = there[0] - even[0] + lags
    if near is not None:
        score = np.where(np.abs(shifts - near) < 0.5, score, -1.0)
    # a short overlap is easily alike: how much more is said by more of it
    return float(shifts[int(np.argmax(score * np.sqrt(np.minimum(n / min(len(seen), len(positions)), 1.0))))])
