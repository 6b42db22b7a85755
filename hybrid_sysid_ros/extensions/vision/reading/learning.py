"""Learning: the layers of a film, and the angle of each of its pictures, without a label."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.extensions.vision.camera.painting import grid_around, painted
from hybrid_sysid_ros.extensions.vision.reading.alignment import Points
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import EXPLAINED, AngleReader
from hybrid_sysid_ros.extensions.vision.reading.camera_motion import unknown_shake
from hybrid_sysid_ros.extensions.vision.reading.layers import Geometry, PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.pivot import LONGEST, PIVOTED, PivotWay, ScaleWay, pivoted
from hybrid_sysid_ros.extensions.vision.reading.regression import (
    Film,
    median_picture,
    polar_maps,
    regress_background,
    regress_texels,
    sharpen,
)
from hybrid_sysid_ros.extensions.vision.reading.unused_pictures import dim_pictures
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RINGS, DIRECTIONS = 48, 1440  # of the maps that give the first angles
ROUNDS, MOST_ROUNDS = 4, 24
"""Of background, sprite and angles in turn: more of them while the pivot is still on its way,"""
WHITE, BURNT = 250.0, 0.05  # counts of 255, and the share of pixels above, with which a film is over-exposed
DARK_FILM = 25.0  # counts of 255
UNSETTLED = 0.3
"""Pixels: a pivot that surely is still farther on its way, or moves more, bends the angles."""
BROAD = 12
"""Waves around the pivot: what is as broad as half of one is no sprite that swings, but somebody who comes by."""
PASSES = 6  # of sharpening in a round
SCALED = 0.01  # pixels of the sprite's end, rms, by which the angles' scale may still be on its way
COARSE = 4  # texels: the spacing at which a sprite's outline is looked for
FEWEST = 40
"""Pictures that a learner needs."""
NARROWEST = 240
"""Columns of a picture: at 160 the first angles have come out mirrored."""
LEAST_MASS = 0.03  # of the ring with most, of one that the sprite reaches; of most pictures', of one that tells
SEEN = 0.75  # of the pictures, by mass: in those above the joint has left its rest, not all show one who comes by
SMALLEST_SWING = 3.0  # pixels of the sprite's end: what moves less is no motion to learn from
ITS_REACH = (0.7, 1.4)
"""Of the scene's sprite, between which that of what was learned lies: drawings are rough, other rigs are others."""
FULL = 2.0 * math.pi
"""A turn [rad]."""
NO_AXIS = 0.1  # of a sprite's second moments: it is as long as broad


def learn(
    film: Film, rig: Rig, *, readout: float, sized: bool = True, steadied: bool = True, clicked: bool = False,
    progress: Callable[[str], object] = lambda stage: None,
) -> tuple[PictureLayers, Array]:  # fmt: skip
    """The layers of pictures (pictures, rows, columns) of a rig's scene, and the angles (pictures,) [rad] of those that
    are not much darker than most.

    The first angles are those by which what differs from the median is turned about the scene's pivot; then background,
    sprite, angles and pivot are improved in turn, each in closed form. readout [s]: see :class:`~.layers.Geometry`.
    sized: whether the scene says how large the sprite is in these pictures, too. steadied: whether it is known how the
    camera moves. clicked: whether the scene's pivot was said for this film.

    Raises UserError where there are too few pictures, or too small ones, nothing moves, what moves does not turn or is
    of another size than the scene's sprite, or the camera shakes in an unknown way.
    """
    if len(film) < FEWEST:
        raise UserError(f"{len(film)} pictures are too few to learn layers from: {FEWEST} at least")
    scene, columns = scene_of(rig), film.shape[2]
    if columns < NARROWEST:
        raise UserError(
            f"pictures of {columns}x{film.shape[1]} pixels are too small to learn layers from: {NARROWEST} columns"
        )
    progress("median")
    lights = _lights(film)
    lit = ~dim_pictures(lights)
    if not lit.all() and lit.sum() >= FEWEST:
        film, lights = film[lit], _lights(film[lit])
    layers, angles = _first_layers(film, lights, rig, readout, progress)
    layers, way, scale = _improved(film, lights, angles, layers, progress)
    share = layers.reach / (columns * max(patch.reach for patch in scene.sprite))
    # pictures show one LONGEST of the way at least; where the pivot moves, angles are those that hang on none
    settled = way.left <= max(UNSETTLED, LONGEST * way.unsure)
    fits = not sized or ITS_REACH[0] < share < ITS_REACH[1]
    if not (settled and fits) and not steadied and way.wander > UNSETTLED:
        raise unknown_shake(way.wander)
    if not settled:
        advice = "click it anew, or film from a tripod" if clicked else "say where it is (--pivot X,Y), or click it"
        raise UserError(
            f"the place about which the joint turns is not found: it still moves by {way.left:.2g} pixels: {advice} "
            "(--check)"
        )
    if not fits:
        raise UserError(
            f"what turns in the pictures reaches {share:.0%} as far from its pivot as the scene of {rig.name} says: is "
            f"it a video of {rig.name}? If it is, say where the pivot is (--pivot X,Y), or click it (--check)"
        )
    unsure = math.hypot(scale.left, scale_deviation(AngleReader(layers).points, angles, max(way.left, PIVOTED)))
    return replace(layers, geometry=replace(layers.geometry, zero=_zero(layers, rig), scale_deviation=unsure)), angles


def _first_layers(
    film: Film, lights: Array, rig: Rig, readout: float, progress: Callable[[str], object]
) -> tuple[PictureLayers, Array]:
    """Layers about the scene's pivot, and the angles (pictures,) [rad] of what differs from the median, where it does.

    Raises UserError where nothing turns.
    """
    scene = scene_of(rig)
    pivot, span = np.array(scene.pivot) * film.shape[2] - 0.5, _span(rig, scene.joint)
    still = median_picture(film, lights)
    few = zip(film[::7], lights[::7], strict=True)
    left = [np.abs(picture / light - still).astype(np.float32) for picture, light in few]
    noise = max(float(np.median(left)) / 0.6745, 0.5)
    progress("first angles")
    angles, reach = _first_angles(film, lights, still, noise, tuple(pivot.tolist()), span)
    known = np.isfinite(angles)
    if not float(np.ptp(angles[known])) * reach > SMALLEST_SWING:
        _refuse_light(still)
        raise UserError("nothing that turns is seen in the pictures: is it the rig's video, and does the rig move?")
    geometry = Geometry(
        rig=rig.name, joint=scene.joint, pivot_x=float(pivot[0]), pivot_y=float(pivot[1]), first_u=0.0, first_v=0.0,
        low=0.0, high=FULL if span >= FULL else 0.0, noise=noise, readout=readout,
    )  # fmt: skip
    layers = _outlined(film[known], lights[known], angles[known], still, geometry, reach)
    tilt, clear = _axis(layers.alpha, *_coordinates(layers))
    if clear > NO_AXIS:  # a sprite that lies along its texels' rows is blurred least between them
        angles = angles - tilt
        layers = _outlined(film[known], lights[known], angles[known], still, geometry, reach)
    return layers, angles


def _improved(
    film: Film, lights: Array, angles: Array, layers: PictureLayers, progress: Callable[[str], object]
) -> tuple[PictureLayers, PivotWay, ScaleWay]:
    """Background, sprite, angles and pivot improved in turn, the ways of pivot and scale; angles (pictures,) change.

    Raises UserError where the layers don't explain half of the pictures.
    """
    full = layers.geometry.high >= FULL
    gains = np.tile(lights[:, None], (1, film.shape[1]))
    good = np.isfinite(angles)
    way, scale = PivotWay(), ScaleWay()
    for turn in range(MOST_ROUNDS):
        progress(f"layers, round {turn + 1}")
        given = angles.copy()
        layers = _regressed(film[good], gains[good], angles[good], layers)
        if not full:
            low, high = float(angles[good].min()), float(angles[good].max())
            layers = replace(layers, geometry=replace(layers.geometry, low=low, high=high))
        reader = AngleReader(layers)
        explained = np.zeros(len(film))
        for k, picture in enumerate(film):
            reading = reader.read(picture)
            gains[k], explained[k] = reader.gains, reading.explained
            angles[k] = reading.angle if reading.found else angles[k]
        good = (explained >= EXPLAINED) & np.isfinite(angles)
        if good.sum() < len(film) / 2:
            _refuse_light(median_picture(film, lights))
            raise UserError(
                f"what moves in the pictures is not one body that turns about a pivot: layers explain "
                f"{good.sum()} of {len(film)} pictures; is it a video of {layers.geometry.rig}?"
            )
        gains[good] /= np.median(gains[good])
        unscaled = scale.left * layers.reach * _spread(angles[good])
        if turn == MOST_ROUNDS - 1 or (turn >= ROUNDS - 1 and way.left < PIVOTED and unscaled < SCALED):
            break
        layers, angles[good] = pivoted(film[good], gains[good], angles[good], layers, reader, way)
        both = good & np.isfinite(given)
        angles[both] = scale.step(given[both], angles[both], alone=way.left < PIVOTED)
    return layers, way, scale


def _lights(film: Film) -> Array:
    """Light of each picture (pictures,), the mean is 1."""
    few = film[:, ::8, ::8].reshape(len(film), -1).astype(float)
    mean = np.maximum(few.mean(axis=0), 1.0)
    found = np.median(few / mean, axis=1)
    return np.asarray(np.maximum(found / max(float(found.mean()), 1e-9), 0.05))


def _refuse_light(still: Array) -> None:
    """Raise UserError where a film from which nothing can be learned is too dark, or over-exposed."""
    if (light := float(still.mean())) < DARK_FILM:
        raise UserError(
            f"nothing that turns can be told, as it is dark, {light:.0f} of 255 counts: film with more light, or a "
            "longer exposure"
        )
    if (white := float((still >= WHITE).mean())) > BURNT:
        raise UserError(
            f"nothing that turns can be told, as {white:.0%} of the pixels are white: film with less light, or a "
            "shorter exposure"
        )


def _span(rig: Rig, joint: str) -> float:
    """How far apart two angles of a joint may be [rad]; a full turn where nothing stops it."""
    names, position = [item.name for item in rig.system.states], rig.joints.joints[joint].position
    if position not in names:
        return FULL
    low, high = rig.travel[:, names.index(position)].tolist()
    return min(high - low, FULL)


def _first_angles(
    film: Film, lights: Array, still: NDArray[np.float32], noise: float, pivot: tuple[float, float], span: float
) -> tuple[Array, float]:
    """Angles (pictures,) [rad] against some picture, by turning maps of what differs from the median over one another,
    and how far the sprite reaches from its pivot [pixels].

    What is brighter than the median is the sprite or, where the median has the sprite in it, its absence; of brighter
    and darker the one is taken that turns more. A picture that differs too little to tell its angle has NaN.
    """
    (rows, columns), angles, reach, most_turned = still.shape, np.zeros(len(film)), 1.0, 0.0
    radius = max(math.hypot(x - pivot[0], y - pivot[1]) for x in (0, columns) for y in (0, rows))
    most = min(round(span / FULL * DIRECTIONS), DIRECTIONS // 2)
    for sign in (1.0, -1.0):
        maps = polar_maps(film, lights, still, pivot, (RINGS, DIRECTIONS), radius, 4.0 * noise + 6.0, sign)
        masses, mass = maps.sum(axis=(1, 2), dtype=np.float64), maps.sum(axis=(0, 2))
        if not mass.max() > 0.0:
            continue
        spectra = np.fft.rfft(maps, axis=2)
        if span < math.pi:
            spectra[:, :, :BROAD] = 0.0
        template = spectra[int(np.argmax(masses))]
        for _ in range(3):
            likeness = np.fft.irfft((spectra * np.conj(template)).sum(axis=1), n=DIRECTIONS, axis=1)
            shifts = np.array([_peak(row, most) for row in likeness])
            turned = np.exp(2j * np.pi * np.arange(spectra.shape[2])[None] * shifts[:, None] / DIRECTIONS)
            template = (spectra * turned[:, None, :]).mean(axis=0)
        found = -2.0 * np.pi * shifts / DIRECTIONS
        tells = masses > LEAST_MASS * np.quantile(masses, SEEN)
        if (much := float(masses[tells] @ np.abs(found - np.median(found[tells]))[tells])) > most_turned:
            angles, most_turned = np.where(tells, found, np.nan), much
            reach = (int(np.flatnonzero(mass > LEAST_MASS * mass.max())[-1]) + 2) / RINGS * radius
    return angles, reach


def _peak(likeness: Array, most: int) -> float:
    """Place of the highest value of a ring within +-most of its beginning, between its points."""
    count = len(likeness)
    near = np.arange(-most, most + 1)
    k = int(near[np.argmax(likeness[near % count])])
    before, here, after = (float(likeness[(k + step) % count]) for step in (-1, 0, 1))
    bend = before - 2.0 * here + after
    return k + (0.5 * (before - after) / bend if bend < 0.0 else 0.0)


def _outlined(
    film: Film, lights: Array, angles: Array, still: NDArray[np.float32], geometry: Geometry, reach: float
) -> PictureLayers:
    """Layers whose texels are those about the sprite; none of them is regressed yet."""
    half = math.ceil(reach)
    size, first = 2 * half + 1, (-float(half), -float(half))
    alpha, texture = np.zeros((size, size), dtype=np.float32), np.zeros((size, size), dtype=np.float32)
    wanted = np.zeros(alpha.shape, dtype=bool)
    wanted[::COARSE, ::COARSE] = wanted[half, ::COARSE] = True
    gains = np.tile(lights[:, None], (1, still.shape[0]))
    pivot = (geometry.pivot_x, geometry.pivot_y)
    regress_texels(film, gains, angles, still, pivot, first, wanted, geometry.noise, alpha, texture)
    coarse = alpha[::COARSE, ::COARSE] > 0.1
    broad = coarse.any(axis=0)
    thin = ~(broad | np.roll(broad, 1) | np.roll(broad, -1))  # a needle may lie between rows, but not the pivot's
    coarse[half // COARSE] |= thin & (alpha[half, ::COARSE] > 0.1)
    crowded = sum(np.roll(coarse, (i, k), (0, 1)).astype(int) for i in (-1, 0, 1) for k in (-1, 0, 1))
    coarse &= crowded >= 3  # one alone is noise
    for axis in (0, 1):
        coarse |= np.roll(coarse, 1, axis) | np.roll(coarse, -1, axis)
    v, u = np.nonzero(coarse)
    if not len(v):
        raise UserError("nothing that turns is seen in the pictures: is it the rig's video, and does the rig move?")
    top, left = max(int(v.min()) - 1, 0) * COARSE, max(int(u.min()) - 1, 0) * COARSE
    bottom, right = (int(v.max()) + 2) * COARSE, (int(u.max()) + 2) * COARSE
    outline = np.kron(coarse, np.ones((COARSE, COARSE), dtype=bool))[top:bottom, left:right]
    return PictureLayers(
        geometry=replace(geometry, first_u=first[0] + left, first_v=first[1] + top),
        background=still.copy(),
        alpha=np.where(outline, 1.0, 0.0).astype(np.float32),
        texture=np.zeros(outline.shape, dtype=np.float32),
    )


def _regressed(film: Film, gains: Array, angles: Array, layers: PictureLayers) -> PictureLayers:
    """Sprite and background anew, from angles (pictures,) and gains (pictures, rows)."""
    background, alpha, texture = (np.array(plane) for plane in (layers.background, layers.alpha, layers.texture))
    noise = layers.geometry.noise
    if texture.any():
        swept = AngleReader(layers).swept
        regress_background(film, gains, angles, alpha, texture, layers.pivot, layers.first, swept, noise, background)
        wanted = np.ones(alpha.shape, dtype=bool)
    else:
        wanted = alpha > 0.0
    regress_texels(film, gains, angles, background, layers.pivot, layers.first, wanted, noise, alpha, texture)
    near = alpha > 0.02
    for axis in (0, 1):
        near |= np.roll(near, 1, axis) | np.roll(near, -1, axis)
    sharpen(film, gains, angles, background, layers.pivot, layers.first, near, noise, PASSES, alpha, texture)
    return PictureLayers(geometry=layers.geometry, background=background, alpha=alpha, texture=texture)


def scale_deviation(points: Points, angles: Array, left: float) -> float:
    """Standard deviation of the scale of angles (pictures,) [rad] that are read by points (points, 2) from the pivot
    [pixels], about which the sprite may still be moved in the pictures by ``left``, rms [pixels].

    A pivot that is off by e moves the sprite by e times the spread of the angles. The angle that fits points p about it
    best is 1 + e . sum p / sum p^2 times the true one: a bar that is held by its end has another scale then, and one
    that is held by its middle has not.
    """
    arm = np.hypot(*points.mean(axis=0)) / np.mean(np.sum(points**2, axis=1))
    return float(left / _spread(angles[np.isfinite(angles)]) * arm)


def _spread(angles: Array) -> float:
    """Of angles (pictures,), rms of the places that they turn to a circle of radius 1 [rad]."""
    return math.sqrt(max(1.0 - abs(np.mean(np.exp(1j * angles))) ** 2, 1e-12))


def _zero(layers: PictureLayers, rig: Rig) -> float:
    """The angle of the sprite where the joint is at 0, by the long axis of the sprite against that of the scene's."""
    scene = scene_of(rig)
    grid = grid_around(scene.sprite, 1.0 / layers.background.shape[1])
    painted_alpha, _ = painted(scene.sprite, grid)
    x, y = grid.axes()
    (wanted, sure), (found, clear) = _axis(painted_alpha, x, y), _axis(layers.alpha, *_coordinates(layers))
    return found - wanted + scene.roll if min(sure, clear) > NO_AXIS else 0.0


def _coordinates(layers: PictureLayers) -> tuple[Array, Array]:
    """U (1, columns) and v (rows, 1) of the texels."""
    rows, columns = layers.alpha.shape
    u: Array = np.arange(columns, dtype=np.float64)[None] + layers.first[0]
    v: Array = np.arange(rows, dtype=np.float64)[:, None] + layers.first[1]
    return u, v


def _axis(alpha: NDArray[np.floating], x: Array, y: Array) -> tuple[float, float]:
    """Direction of a cover's long axis [rad], clockwise, and how much longer it is than broad, from 0 to 1."""
    total = max(float(alpha.sum()), 1e-9)
    x, y = x - float((alpha * x).sum()) / total, y - float((alpha * y).sum()) / total
    xx, yy, xy = (float((alpha * product).sum()) for product in (x * x, y * y, x * y))
    return 0.5 * math.atan2(2.0 * xy, xx - yy), math.hypot(2.0 * xy, xx - yy) / max(xx + yy, 1e-9)
