"""Layers learned from pictures alone, against the motion and the scene that were put before the camera."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.layers import Geometry
from hybrid_sysid_ros.extensions.vision.reading.learning import (
    UNSETTLED,
    _first_angles,
    _outlined,
    learn,
    scale_deviation,
)
from hybrid_sysid_ros.extensions.vision.reading.pivot import PivotWay, ScaleWay
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.extensions.vision.scene import scene_of, with_pivot
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIG = load("cam_beam")
CAMERA = Camera(width=320, height=180)
TIMES: Array = np.arange(0.0, 30.0, 0.001, dtype=np.float64)
ANGLES: Array = 0.06 * np.sin(2 * np.pi * 0.11 * TIMES) + 0.04 * np.sin(2 * np.pi * 0.37 * TIMES + 1.0)


def _film(count: int, angles: Array = ANGLES, seed: int = 0) -> tuple[Film, Array, Imager]:
    imager = Imager(scene_of(RIG), CAMERA, seed=seed)
    times: Array = 0.5 + 28.0 * np.arange(count, dtype=np.float64) / count
    return np.stack([imager.take(time, TIMES, angles) for time in times]), times, imager


@pytest.mark.slow
def test_layers_are_learned_without_a_label() -> None:
    film, _, _ = _film(80)
    layers, _ = learn(film, RIG, readout=CAMERA.readout)
    scene, reader = scene_of(RIG), AngleReader(layers)
    assert layers.pivot[0] == pytest.approx(scene.pivot[0] * 320 - 0.5, abs=0.5)
    unseen, times, imager = _film(50, seed=9)
    readings = [reader.read(picture) for picture in unseen]
    assert all(reading.found for reading in readings)
    truth = [
        imager.mean_angle(time, TIMES, ANGLES, row=reading.row) for time, reading in zip(times, readings, strict=True)
    ]
    errors = np.degrees([reading.angle for reading in readings]) - np.degrees(truth)
    assert np.std(errors) < 0.02
    # the zero is that of the drawing, as far as the sprite's long axis tells it
    assert errors.mean() - math.degrees(layers.geometry.zero) == pytest.approx(0.0, abs=0.05)


@pytest.mark.slow
def test_somebody_who_comes_by_leaves_no_trace() -> None:
    """12 % of the width, all of the height, to and fro: angles are as without, and what is no bar covers nothing."""
    covered, times, imager = _film(120)
    for picture, time in zip(covered, times, strict=True):
        left = round((0.5 + 0.5 * math.sin(2.0 * math.pi * 0.23 * time)) * 0.88 * CAMERA.width)
        picture[:, left : left + round(0.12 * CAMERA.width)] = 102
    layers, _ = learn(covered, RIG, readout=CAMERA.readout)
    reader = AngleReader(layers)
    readings = [reader.read(picture) for picture in covered]
    truth = [
        imager.mean_angle(time, TIMES, ANGLES, row=reading.row) for time, reading in zip(times, readings, strict=True)
    ]
    errors = np.degrees([reading.angle for reading in readings]) - np.degrees(truth)
    assert np.std(errors) < 0.04  # .02 at twice the width
    assert np.abs(errors - errors.mean()).max() < 0.2
    v = np.arange(len(layers.alpha)) + layers.geometry.first_v - 0.006 * CAMERA.width  # from the bar's middle
    beside = np.abs(v) > 0.0151 / 2 * CAMERA.width + 3.0  # pixels from its edge, for the blur
    assert beside.any()
    assert layers.alpha[beside].max() < 0.05


@pytest.mark.slow
def test_a_pivot_that_is_off_bends_no_angles() -> None:
    """A joint that rests at either end of its way, as layers of a wrong pivot agree with it best there."""
    rig = load("flexible_joint")
    scene = scene_of(rig)
    x, y = scene.pivot
    imager = Imager(scene, CAMERA, seed=0)
    truth = np.concatenate([np.full(20, -1.2), np.linspace(-1.2, 0.3, 10), np.full(20, 0.3)])
    ends = np.array([0.0, 1.0])
    film = np.stack([imager.take(0.5, ends, np.full(2, angle)) for angle in truth])
    layers, angles = learn(film, with_pivot(rig, (x + 0.008, y - 0.007)), readout=CAMERA.readout)
    assert layers.pivot == pytest.approx((x * 320 - 0.5, y * 320 - 0.5), abs=UNSETTLED)  # 3 pixels beside at first
    errors = np.degrees((angles - truth + np.pi) % (2.0 * np.pi) - np.pi)
    assert np.std(errors) < 0.03


@pytest.mark.parametrize("sways", [0.0, 0.7])
def test_a_pivot_that_moves_with_the_camera_makes_steps_as_unsure_as_they_are(sways: float) -> None:
    """Against the scatter of least squares over many films, in which it lies .6 pixels elsewhere along each axis. Where
    a hand sways, each place is like the one before.
    """
    random, turned = np.random.default_rng(0), np.sin(np.linspace(0.0, 12.0, 160))
    c, s = np.cos(turned), np.sin(turned)
    moves = np.vstack([np.column_stack([1 + 0 * c, 0 * c, c, -s]), np.column_stack([0 * c, 1 + 0 * c, s, c])])
    ways, unsure = [], []
    for _ in range(200):
        new, places = math.sqrt(1.0 - sways**2) * random.standard_normal((2, 160)), np.zeros((2, 160))
        places[:, 0] = random.standard_normal(2)
        for k in range(1, 160):
            places[:, k] = sways * places[:, k - 1] + new[:, k]
        way = PivotWay()
        shown = np.linalg.lstsq(moves, 0.6 * places.ravel(), rcond=None)[0]
        way.step(shown, moves, 0.6 * places.ravel())
        unsure.append(way.unsure)
        ways.append(2.0 * np.mean((moves @ shown) ** 2))
    assert np.mean(unsure) == pytest.approx(math.sqrt(np.mean(ways)), rel=0.15)


@pytest.mark.slow
def test_a_camera_that_shakes_unknown_is_the_reason_for_layers_that_fit_no_scene() -> None:
    film, _, _ = _film(60)
    shaken = np.stack(
        [np.roll(each, np.random.default_rng(k).integers(-2, 3, 2), (0, 1)) for k, each in enumerate(film)]
    )
    with pytest.raises(UserError, match="the camera shakes: the joint's pivot moves by"):
        learn(shaken, with_pivot(RIG, (0.5, 0.9)), readout=CAMERA.readout, steadied=False)


@pytest.mark.parametrize("begin", [-40.0, 0.0, 20.0])
def test_a_pivot_that_is_off_makes_as_large_a_scale_as_is_said(begin: float) -> None:
    """Against a fit of a bar's places about a pivot that lies half a pixel beside, along it and across."""
    points = np.column_stack([np.linspace(begin, 40.0, 50), np.zeros(50)]).astype(np.float32)
    angles = 0.04 * np.sin(np.linspace(0.0, 12.0, 100))
    off, left, scales = 0.5, [], []
    for direction in np.linspace(0.0, np.pi, 40):
        u = points[:, 0] - off * np.cos(direction)
        v = np.full(50, -off * np.sin(direction))
        true = np.array([points[:, 0] * np.sin(a) - points[:, 0] * 0.0 for a in angles]).T
        found = (u @ true) / (u @ u + v @ v)
        scales.append(float(np.polyfit(angles, found, 1)[0]) - 1.0)
        left.append(off * np.std(angles))
    stated = scale_deviation(points, angles, float(np.mean(left)))
    assert np.max(np.abs(scales)) == pytest.approx(stated, rel=0.05, abs=1e-3)


@pytest.mark.parametrize(("agrees", "middle"), [(0.5, 0.0), (0.8, 3.1)])
def test_angles_that_layers_agree_with_in_part_are_soon_of_the_true_size(agrees: float, middle: float) -> None:
    """Layers that were learned by angles a fifth too large find them too large by half, or by four fifths, of that;
    also about a middle at which a turn begins anew.
    """
    true: Array = middle + 0.05 * np.sin(np.linspace(0.0, 12.0, 100))
    way, given = ScaleWay(), middle + 1.2 * (true - middle)
    for _ in range(5):
        found = true + agrees * (given - true)
        given = (
            true
            + (way.step(given, (found + np.pi) % (2.0 * np.pi) - np.pi, alone=True) - true + np.pi) % (2.0 * np.pi)
            - np.pi
        )
    assert np.ptp(given) == pytest.approx(np.ptp(true), rel=1e-3)
    assert way.left < 1e-3


def test_angles_that_go_all_around_have_no_scale() -> None:
    way, angles = ScaleWay(), np.linspace(0.0, 6.0, 50)
    assert way.step(angles, angles + 0.01, alone=True).tolist() == (angles + 0.01).tolist()
    assert way.left == 0.0


def test_a_film_in_which_nothing_moves_is_refused() -> None:
    film, _, _ = _film(45, angles=np.zeros(len(TIMES)))
    with pytest.raises(UserError, match="nothing that turns"):
        learn(film, RIG, readout=CAMERA.readout)


def test_few_pictures_are_refused() -> None:
    film, _, _ = _film(10)
    with pytest.raises(UserError, match="too few"):
        learn(film, RIG, readout=CAMERA.readout)


def test_small_pictures_are_refused() -> None:
    film, _, _ = _film(45)
    with pytest.raises(UserError, match="160x90 pixels are too small"):
        learn(np.ascontiguousarray(film[:, ::2, ::2]), RIG, readout=CAMERA.readout)


@pytest.mark.parametrize(
    ("counts", "words"),
    [(255, "100% of the pixels are white: film with less light"), (3, "it is dark, 3 of 255 counts")],
)
def test_a_film_that_is_white_or_dark_is_refused_by_its_light(counts: int, words: str) -> None:
    film = np.full((60, 136, 240), counts, dtype=np.uint8)
    with pytest.raises(UserError, match=words):
        learn(film, load("cam_beam"), readout=0.0)


def test_a_light_bar_that_rests_for_long_is_read_where_it_is_seen_and_not_where_it_is_missed() -> None:
    """The median has it in its place of rest, and noise there is all that is darker while it rests."""
    random = np.random.default_rng(0)
    truth = np.concatenate([np.zeros(30), 0.2 * np.sin(np.linspace(0.0, 12.0, 25))])
    y, x = np.mgrid[:90, :160] - np.array([45.0, 80.0])[:, None, None]
    bars = [
        np.clip(2.0 - np.abs(y * np.cos(angle) + x * np.sin(angle)), 0.0, 1.0) * (np.hypot(x, y) < 70.0)
        for angle in truth
    ]
    film = np.clip(140.0 + 80.0 * np.array(bars) + 0.3 * random.standard_normal((55, 90, 160)), 0, 255).astype(np.uint8)
    film[3, 60:64, 20:24] = 120  # a spot of something else
    still = np.median(film, axis=0).astype(np.float32)
    angles, _ = _first_angles(film, np.ones(55), still, 0.5, (80.0, 45.0), math.radians(26.0))
    known = np.isfinite(angles)
    assert known[30:].sum() > 20
    assert np.std(np.degrees(angles - truth)[known]) < 1.0  # improved later


def test_the_outline_of_a_needle_reaches_to_its_end() -> None:
    """It is thinner than the grid at which outlines are looked for, whose rows it lies along."""
    angles: Array = 0.2 * np.sin(np.linspace(0.0, 12.0, 40))
    y, x = np.mgrid[:90, :160] - np.array([45.0, 80.0])[:, None, None]
    across, along = (
        np.array([p * np.cos(angle) + sign * q * np.sin(angle) for angle in angles])
        for p, q, sign in ((y, x, 1.0), (x, y, -1.0))
    )
    needle = np.clip(1.0 - np.abs(across), 0.0, 1.0) * (along > 0.0) * (along < 62.0)
    film = (140.0 - 110.0 * needle).astype(np.uint8)
    still = np.full((90, 160), 140.0, dtype=np.float32)
    geometry = Geometry(
        rig="", joint="", pivot_x=80.0, pivot_y=45.0, first_u=0.0, first_v=0.0, low=0.0, high=0.0, noise=0.5,
        readout=0.0,
    )  # fmt: skip
    layers = _outlined(film, np.ones(40), angles, still, geometry, 62.0)
    shown = np.flatnonzero(layers.alpha.any(axis=0)) + layers.first[0]
    assert shown.min() <= 4.0
    assert 58.0 <= shown.max() <= 70.0
