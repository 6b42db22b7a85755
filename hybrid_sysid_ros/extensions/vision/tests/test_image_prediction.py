"""Pictures ahead: where the model is the rig, they are those that come, as far as nobody disturbs it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.extensions.vision.camera.filming import experiment, filmed
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager, Picture
from hybrid_sysid_ros.extensions.vision.camera_loop import frame_noise
from hybrid_sysid_ros.extensions.vision.prediction.image_prediction import (
    Judged,
    PictureModel,
    PredictedFrame,
    SeenMotion,
    Summary,
    judged,
    looks,
    of_video,
)
from hybrid_sysid_ros.extensions.vision.prediction.motion_prediction import DRIFTS
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.footage import followed
from hybrid_sysid_ros.extensions.vision.reading.layers import KIND, PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.renderer import LayerRenderer, Renderer
from hybrid_sysid_ros.extensions.vision.reading.video_record import joined
from hybrid_sysid_ros.extensions.vision.report.video_figures import positions
from hybrid_sysid_ros.extensions.vision.report.video_page import write_video
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIG = load("cam_beam")
CAMERA = Camera(width=160, height=90, noise=0.6)


@pytest.fixture(scope="module")
def rows(model_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Judged]:
    """Of 9 s of the beam under its multisine."""
    bag = tmp_path_factory.mktemp("ahead") / "bag"
    motion = experiment(RIG, "multisine", bag, seed=3, duration=9.0, rate=200.0)
    imager = Imager(scene_of(RIG), CAMERA)
    times = imager.lead + np.arange(int(8.9 * CAMERA.rate)) / CAMERA.rate
    film = [imager.take(time, motion.times, motion.angles) for time in times]
    layers = painted_layers(RIG, CAMERA)
    reader = AngleReader(layers)
    readings = [reader.read(picture) for picture in film]
    watched = SeenMotion(
        times=times,
        seen=times + np.array([layers.row_time(reading.row) for reading in readings]),
        positions=np.array([layers.position(reading.angle) for reading in readings]),
    )
    model = PictureModel(model=load_model(model_folder), renderer=LayerRenderer(layers, exposure=CAMERA.exposure))
    record = bags.read(bag, RIG.signals)
    found = looks(model, RIG, record, watched, noise=frame_noise(RIG, CAMERA.width))
    mean = np.mean(film, axis=0).astype(np.uint8)
    return [judged(look, dict(enumerate(film)), mean, reader, watched) for look in found]


def test_what_comes_is_what_was_predicted(rows: list[Judged]) -> None:
    assert {row.look.ahead for row in rows} == {0.5, 1.0, 2.0}
    for ahead in (0.5, 2.0):
        found = Summary.of(rows, ahead)
        assert found.count >= 4
        assert math.degrees(found.error) < 0.5  # of a swing of some 6: friction, disturbances and noise
        assert found.shown == pytest.approx(found.error, abs=math.radians(0.05))
        assert found.likeness > 0.9
        assert found.likeness > max(found.mean, found.still) + 0.2


def test_the_band_grows_and_holds_the_most(rows: list[Judged]) -> None:
    near, far = (np.mean([row.look.deviation for row in rows if row.look.ahead == ahead]) for ahead in (0.5, 2.0))
    assert 0.0 < near < far < math.radians(1.0)
    assert np.mean([Summary.of(rows, ahead).inside for ahead in (0.5, 1.0, 2.0)]) > 0.5


class Unpainted(Renderer):
    """Where only positions are asked for."""

    def take(self, time: float, times: Array, angles: Array) -> Picture:
        return np.zeros((1, 1), dtype=np.uint8)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Record, SeenMotion]:
    """30 s of the beam under random steps, and where it was, as often as a camera shows it."""
    bag = tmp_path_factory.mktemp("steps") / "bag"
    motion = experiment(RIG, "random_steps", bag, seed=4, duration=30.0, rate=200.0)
    times = np.arange(int(29.9 * CAMERA.rate)) / CAMERA.rate
    return bags.read(bag, RIG.signals), SeenMotion(
        times=times, seen=times, positions=np.interp(times, motion.times, motion.angles)
    )


def foretold(
    model_folder: Path, record: Record, watched: SeenMotion, drifts: Sequence[float] = DRIFTS
) -> list[PredictedFrame]:
    """2 s ahead, once predictions have come true."""
    model = PictureModel(model=load_model(model_folder), renderer=Unpainted())
    noise = frame_noise(RIG, CAMERA.width)
    return list(looks(model, RIG, record, watched, noise=noise, ahead=(2.0,), drifts=drifts))[4:]


def rms(found: Sequence[PredictedFrame], watched: SeenMotion) -> float:
    return math.degrees(np.sqrt(np.mean([(look.position - watched.positions[look.frame]) ** 2 for look in found])))


def inside(found: Sequence[PredictedFrame], watched: SeenMotion) -> float:
    """Share within two deviations: .954 of a normal one."""
    return float(
        np.mean([abs(look.position - watched.positions[look.frame]) <= 2.0 * look.deviation for look in found])
    )


def test_an_input_without_an_offset_is_predicted_as_one(model_folder: Path, shown: tuple[Record, SeenMotion]) -> None:
    record, watched = shown
    chosen, alone = foretold(model_folder, record, watched), foretold(model_folder, record, watched, (1.0,))
    assert {look.drift for look in chosen} <= {0.0, 0.1}
    assert rms(chosen, watched) < 0.7 * rms(alone, watched)


@pytest.mark.parametrize("turns", [False, True])
def test_an_input_with_an_offset_is_followed(model_folder: Path, shown: tuple[Record, SeenMotion], turns: bool) -> None:
    record, watched = shown
    offset = 0.3 * np.sign(record.time - 15.0) if turns else np.full(record.samples, 0.3)  # V
    record = replace(record, input=record.input - offset[:, None])
    chosen, alone, without = (foretold(model_folder, record, watched, drifts) for drifts in (DRIFTS, (1.0,), (0.0,)))
    assert 0.0 not in {look.drift for look in chosen}
    assert rms(chosen, watched) < 1.1 * rms(alone, watched) < 0.5 * rms(without, watched)
    if not turns:  # a jump is what no band of a drift tells
        assert inside(chosen, watched) > 0.9


def test_a_picture_model_is_a_model_with_layers_in_its_folder(model_folder: Path, tmp_path: Path) -> None:
    load_model(model_folder).save(tmp_path / "model")
    with pytest.raises(UserError, match="no such layers folder"):
        PictureModel.load(tmp_path / "model", exposure=0.008)
    layers = painted_layers(RIG, CAMERA)
    layers.save(tmp_path / "model" / KIND)
    found = PictureModel.load(tmp_path / "model", exposure=0.008)
    motion = np.array([0.0, 1.0]), np.full(2, 0.05)
    wanted = LayerRenderer(PictureLayers.load(tmp_path / "model" / KIND), exposure=0.008).take(0.5, *motion)
    assert np.array_equal(found.renderer.take(0.5, *motion), wanted)
    other = replace(layers, geometry=replace(layers.geometry, rig="wheel_motor"))
    other.save(tmp_path / "model" / KIND)
    with pytest.raises(UserError, match="layers are of wheel_motor"):
        PictureModel.load(tmp_path / "model", exposure=0.008)


@pytest.mark.slow
def test_pictures_of_a_film_are_predicted_and_shown(model_folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("av", reason="needs the extra video")
    bag, film = tmp_path / "bag", tmp_path / "film.mp4"
    filmed(RIG, "multisine", bag, film, CAMERA, seed=3, duration=6.0, rate=200.0, crf=10)
    layers, model = painted_layers(RIG, CAMERA), load_model(model_folder)
    footage = followed(FilmView(path=film), AngleReader(layers), None)
    record = joined(footage, layers, RIG, bag, exposure=CAMERA.exposure)
    rows = of_video(film, model, RIG, bag, record, layers, exposure=CAMERA.exposure)
    found = Summary.of(rows, 0.5)
    assert found.likeness > max(found.mean, found.still) + 0.1
    assert math.degrees(found.error) < 0.5
    page = write_video(
        tmp_path / "film.html", record, layers, "film", report.provenance(model, "video"), ahead=rows
    ).read_text(encoding="utf-8")
    assert f"likeness {max(row.likeness for row in rows if row.look.ahead == 2.0):.3f}" in page
    places = re.findall(r' id="([^"]*)"', page.rpartition("</head>")[2])
    assert len(places) == len({*places})  # or a figure is drawn into a heading
    (left,) = [curve.y for curve in positions(record).data if curve.name == "camera less encoder"]
    assert record.synchronisation is not None
    assert abs(np.nanmean(left)) < math.degrees(record.synchronisation.residual)  # frames show a hum as an offset
    alone = joined(footage, layers, RIG, None, exposure=CAMERA.exposure)
    with pytest.raises(UserError, match="without a bag there are no inputs"):
        of_video(film, model, RIG, bag, alone, layers, exposure=CAMERA.exposure)
    early = replace(footage, times=footage.times - 5.0, seen=footage.seen - 5.0)
    initial = replace(record, footage=early)
    with pytest.raises(UserError, match="too short to predict"):
        of_video(film, model, RIG, bag, initial, layers, exposure=CAMERA.exposure)
