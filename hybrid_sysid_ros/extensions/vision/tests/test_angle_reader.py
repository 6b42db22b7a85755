"""The angle reader against the motion that was put before the camera."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import STANDS, AngleReader
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.light_across import LightMeter
from hybrid_sysid_ros.extensions.vision.reading.unused_pictures import unlike_pictures
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIG = load("cam_beam")
CAMERA = Camera()
TIMES: Array = np.arange(0.0, 3.0, 0.001, dtype=np.float64)


@pytest.fixture(scope="module")
def reader() -> AngleReader:
    return AngleReader(painted_layers(RIG, CAMERA))


@pytest.mark.parametrize("angle", [-0.12, -0.05, 0.0, 0.02, 0.11])
def test_an_angle_is_read_to_some_thousandths_of_a_degree(reader: AngleReader, angle: float) -> None:
    picture = Imager(scene_of(RIG), CAMERA, seed=1).take(1.5, TIMES, np.full(len(TIMES), angle))
    reading = reader.read(picture)
    assert math.degrees(reader.layers.position(reading.angle) - angle) == pytest.approx(0.0, abs=0.01)
    assert 0.0002 < math.degrees(reading.deviation) < 0.01


def test_the_row_tells_at_which_moment_the_angle_was_that(reader: AngleReader) -> None:
    """At 1 rad/s, three milliseconds of rolling shutter are .17 degrees."""
    imager = Imager(scene_of(RIG), CAMERA, seed=2)
    for middle in (0.02, -0.05):
        reading = reader.read(imager.take(1.5, TIMES, middle + 1.0 * (TIMES - 1.5)))
        expected = middle + reader.layers.row_time(reading.row)
        assert math.degrees(reader.layers.position(reading.angle) - expected) == pytest.approx(0.0, abs=0.02)


def test_a_picture_without_the_joint_is_unlike_the_others(reader: AngleReader) -> None:
    """An alignment takes what stands for some angle, and explains it by a deviation that is as large."""
    seen = Imager(scene_of(RIG), CAMERA, seed=1).take(1.5, TIMES, np.zeros(len(TIMES)))
    gone = np.clip(np.round(reader.layers.background), 0, 255).astype(np.uint8)
    differences: Array = np.array([reader.read(picture).difference for picture in (seen, seen, seen, gone)])
    assert unlike_pictures(differences).tolist() == [False, False, False, True]


@pytest.mark.parametrize("middle", [-1.0, 0.3])
def test_the_row_of_an_angle_that_no_place_changes_is_another(middle: float) -> None:
    """It hangs on what is far from the middle of an arm that reaches from its pivot to one side."""
    rig, speed = load("flexible_joint"), 1.5
    reader = AngleReader(painted_layers(rig, CAMERA, low=-1.2, high=0.5))
    picture = Imager(scene_of(rig), CAMERA, seed=2).take(1.5, TIMES, middle + speed * (TIMES - 1.5))
    angle = reader.read(picture).angle
    free = reader.read_freely(picture, angle, reader.gains)
    expected = middle + speed * reader.layers.row_time(free.row)
    assert math.degrees(reader.layers.position(free.angle) - expected) == pytest.approx(0.0, abs=0.03)


def test_the_deviation_is_that_of_many_readings(reader: AngleReader) -> None:
    imager = Imager(scene_of(RIG), Camera(noise=8.0), seed=3)
    readings = [reader.read(imager.take(1.5, TIMES, np.full(len(TIMES), 0.033))) for _ in range(60)]
    spread = np.std([reading.angle for reading in readings])
    assert np.mean([reading.deviation for reading in readings]) == pytest.approx(spread, rel=0.6)


@pytest.mark.parametrize("dim", [0.3, 1.4])
def test_light_does_not_move_the_angle(reader: AngleReader, dim: float) -> None:
    imager = Imager(scene_of(RIG), Camera(gain=dim, flicker=0.06), seed=4)
    reading = reader.read(imager.take(1.5, TIMES, np.full(len(TIMES), -0.04)))
    assert math.degrees(reader.layers.position(reading.angle) + 0.04) == pytest.approx(0.0, abs=0.015)


@pytest.mark.parametrize("angle", [-0.1, -0.04, 0.06])
def test_light_from_one_side_does_not_move_the_angle(reader: AngleReader, angle: float) -> None:
    picture = Imager(scene_of(RIG), CAMERA, seed=3).take(1.5, TIMES, np.full(len(TIMES), angle))
    across = 1.0 + 0.25 * np.linspace(-1.0, 1.0, picture.shape[1])
    leaning = np.clip(picture * across + 0.5, 0.0, 255.0).astype(np.uint8)
    seen, own = (reader.read(each).angle for each in (LightMeter(reader.layers.background).evened(leaning), picture))
    assert math.degrees(seen - own) == pytest.approx(0.0, abs=0.005)


def test_pixels_that_are_white_do_not_move_the_angle() -> None:
    """Under twice the light all of the bar is white, and half of the layers' difference would be that."""
    layers = painted_layers(RIG, CAMERA)
    reader = AngleReader(layers)
    random, error = np.random.default_rng(6), list[float]()
    for angle in np.linspace(-0.1, 0.1, 9).tolist():
        drawn = 2.0 * layers.drawn(angle) + 2.5 * random.standard_normal(layers.background.shape)
        reading = reader.read(np.clip(drawn + 0.5, 0.0, 255.0).astype(np.uint8))
        error.append(math.degrees(reading.angle - angle))
        assert abs(error[-1]) < 3.0 * math.degrees(reading.deviation)
    assert np.abs(error).max() < 0.01


def test_rows_that_the_joint_comes_over_whole_have_the_light_of_those_around_them() -> None:
    """A bar as long as the picture is wide leaves nothing that stands in the rows where it rests."""
    layers = painted_layers(RIG, CAMERA)
    reader = AngleReader(layers)
    reader._columns[160:200] = -1
    reader.read(np.clip(0.6 * layers.drawn(0.05), 0.0, 255.0).astype(np.uint8))
    assert reader.gains[150:210] == pytest.approx(0.6, abs=0.01)


def test_who_stands_behind_the_pivot_is_not_taken_for_light() -> None:
    """There the rows leave but a narrow place between the bar's two sides, which one person fills."""
    layers = painted_layers(RIG, CAMERA)
    background = layers.background.copy()
    background[:, 280:360] *= 0.5
    picture = np.clip(replace(layers, background=background).drawn(0.05), 0.0, 255.0).astype(np.uint8)
    reader = AngleReader(layers)
    assert math.degrees(reader.read(picture).angle - 0.05) == pytest.approx(0.0, abs=0.01)
    assert reader.gains == pytest.approx(1.0, abs=0.02)


def test_who_hides_the_middle_does_not_lose_the_sprite(reader: AngleReader) -> None:
    """There the sprite moves least, and its ends, which are left, must be met by a scan to a pixel or two."""
    imager = Imager(scene_of(RIG), CAMERA, seed=5)
    for angle in np.linspace(-0.11, 0.11, 45):
        picture = imager.take(1.5, TIMES, np.full(len(TIMES), angle))
        picture[:, 260:340] = 102
        found = reader.layers.position(reader.read(picture).angle)
        assert math.degrees(found - angle) == pytest.approx(0.0, abs=0.05)


def test_nothing_is_found_in_the_dark_and_in_another_rigs_picture(reader: AngleReader) -> None:
    dark = np.zeros((360, 640), dtype=np.uint8)
    other = Imager(scene_of(load("wheel_motor")), CAMERA).take(1.5, TIMES, np.zeros(len(TIMES)))
    assert not reader.read(dark).found
    for seed in range(5):  # a lens cap: noise alone, which may look like a sprite anywhere
        capped = Imager(scene_of(RIG), Camera(gain=0.0), seed=seed).take(1.5, TIMES, np.zeros(len(TIMES)))
        assert not reader.read(capped).found
    assert reader.standing([reader.scenery(other)]) < STANDS


def test_a_picture_of_another_size_is_refused(reader: AngleReader) -> None:
    with pytest.raises(UserError, match="learned at 640x360"):
        reader.read(np.zeros((100, 100), dtype=np.uint8))


def test_layers_are_kept_in_a_folder(reader: AngleReader, tmp_path: Path) -> None:
    reader.layers.save(tmp_path / "layers")
    again = PictureLayers.load(tmp_path / "layers")
    assert again.geometry == reader.layers.geometry
    assert np.abs(again.background - reader.layers.background).max() < 0.1
    with pytest.raises(UserError):
        PictureLayers.load(tmp_path)
