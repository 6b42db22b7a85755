"""What angles scatter by from picture to picture is known without what the joint does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReading, FreeReading
from hybrid_sysid_ros.extensions.vision.reading.steadiness import held, scatter, steady_angles
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NOISE = 1e-4  # rad


@pytest.mark.parametrize("irregular", [0.0, 0.2])
@pytest.mark.parametrize("turns", [False, True])
def test_scatter_is_the_noise_and_not_the_motion(irregular: float, turns: bool) -> None:
    """A phone's pictures are not at even times; a motion of 2 Hz is much larger than the noise."""
    random = np.random.default_rng(0)
    times: Array = (np.arange(600) + irregular * random.uniform(-0.5, 0.5, 600)) / 30.0
    angles = 0.1 * np.sin(2.0 * np.pi * 2.0 * times) + NOISE * random.standard_normal(600)
    if turns:
        angles = (angles + 3.0 * times) % (2.0 * np.pi)
    angles[100:103] = np.nan
    assert scatter(times, angles, 2.0 * np.pi if turns else 0.0) == pytest.approx(NOISE, rel=0.15)


def test_errors_that_a_codec_keeps_for_some_pictures_scatter_as_much() -> None:
    """At 240 pictures a second each error is there in eight of them, which differences of neighbours hardly see."""
    times: Array = np.arange(8000) / 240.0
    kept = np.repeat(NOISE * np.random.default_rng(0).standard_normal(1000), 8)
    angles = 0.1 * np.sin(2.0 * np.pi * 2.0 * times) + kept
    assert scatter(times, angles) == pytest.approx(NOISE, rel=0.15)


def test_a_fast_motion_is_no_scatter_of_every_second_picture() -> None:
    """At 60 pictures a second 7 Hz are far below half of their rate, but not of that of every second one."""
    times: Array = np.arange(1200) / 60.0
    noise = NOISE * np.random.default_rng(0).standard_normal(1200)
    assert scatter(times, 0.05 * np.sin(2.0 * np.pi * 7.0 * times) + noise) == pytest.approx(NOISE, rel=0.15)


def test_few_pictures_have_no_scatter() -> None:
    few: Array = np.arange(12, dtype=np.float64)
    assert scatter(few, 0.0 * few) == 0.0


@pytest.mark.parametrize(("name", "parts"), [("wheel_motor", 5), ("drill_string", 3)])
def test_a_sprite_that_looks_alike_after_a_part_of_a_turn_has_that_period(name: str, parts: int) -> None:
    layers = painted_layers(load(name), Camera(width=240, height=136), low=0.0, high=2.0 * np.pi)
    assert layers.full_turn
    assert layers.period == pytest.approx(2.0 * np.pi / parts)


def test_pictures_that_a_codec_repeats_at_rest_tell_nothing_of_the_scatter() -> None:
    """Half a film at rest is one picture again and again; the other half scatters as it does without the rest."""
    times: Array = np.arange(600) / 30.0
    angles = 0.1 * np.sin(2.0 * np.pi * times) + NOISE * np.random.default_rng(0).standard_normal(600)
    angles[:310] = angles[0]
    repeated = held(angles, np.full(600, NOISE))
    assert repeated[1:310].all()
    assert not repeated[310:].any()
    assert scatter(times, angles) < 0.5 * NOISE
    assert scatter(times, angles, repeated=repeated) == pytest.approx(NOISE, rel=0.15)


@pytest.mark.parametrize("rate", [30.0, 60.0])
def test_many_pictures_tell_that_a_codec_leaves_out_more_than_it_states(rate: float) -> None:
    """Of thirty a second a joint's unrest may be what scatters; of sixty it is an error."""
    layers, count = painted_layers(load("cam_beam"), Camera(width=240, height=136)), 600
    angles = NOISE * np.random.default_rng(0).standard_normal(count)
    rows = [
        AngleReading(angle=angle, deviation=1e-5, row=60.0, difference=1.0, explained=1.0, per_count=1e-7)
        for angle in angles.tolist()
    ]
    free = FreeReading(angle=np.nan, x=0.0, y=0.0, deviation=1e-5, beside=0.01, row=60.0)
    stated = steady_angles(np.arange(count) / rate, rows, [free] * count, None, layers, np.full(count, 10.0)).deviations
    assert float(np.median(stated)) == pytest.approx(NOISE if rate == 60.0 else 1e-5, rel=0.2)


@pytest.mark.parametrize(
    ("step", "per_count", "light", "words"),
    [
        (226.0, 1.2e-4, 1.0, "compressed strongly"),
        (30.0, 1e-3, 1.0, "edges are soft"),
        (9.0, 4e-3, 0.1, "too dark, 1[0-9] of 255"),
        (14.0, 1e-4, 1.0, ""),
        (np.nan, 1e-4, 1.0, ""),
    ],
)
def test_what_a_codec_leaves_out_is_in_the_deviation_or_refused(
    step: float, per_count: float, light: float, words: str
) -> None:
    layers, count = painted_layers(load("cam_beam"), Camera(width=240, height=136)), 60
    layers = replace(layers, background=(light * layers.background).astype(np.float32))
    row = AngleReading(angle=0.0, deviation=1e-5, row=60.0, difference=1.0, explained=1.0, per_count=per_count)
    free = FreeReading(angle=0.0, x=0.0, y=0.0, deviation=1e-5, beside=0.01, row=60.0)
    times: Array = np.arange(count) / 30.0

    def read() -> Array:
        return steady_angles(times, [row] * count, [free] * count, None, layers, np.full(count, step)).deviations

    if words:
        with pytest.raises(UserError, match=words):
            read()
        return
    coded = 0.0 if np.isnan(step) else step * per_count
    assert 0.02 * coded <= float(read()[0]) <= 0.05 * coded + 2e-5
