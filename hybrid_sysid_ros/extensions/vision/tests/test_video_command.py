"""hybrid-sysid video: a film becomes a bag; what is wrong with one is reported in a line, and nothing is written."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av", reason="needs the extra video")
pytest.importorskip("PIL", reason="needs the extra video")
pytest.importorskip("cv2", reason="needs the extra video")

from PIL import Image

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.vision.camera.film import CRF, write_film
from hybrid_sysid_ros.extensions.vision.camera.filming import BEFORE, SceneMotion, experiment, film
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager, Picture
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.footage import followed
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array
from tests.command_line import Answer, refused

RIG, CAMERA = load("cam_beam"), Camera(width=320, height=180)
SECONDS = 6.0
Frames = list[tuple[float, Picture]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Filmed:
    """An experiment of the beam, its film and its layers."""

    bag: Path
    layers: Path
    frames: Frames
    motion: SceneMotion

    @property
    def fewer(self) -> Frames:
        """Every second picture, which is enough to see what is wrong with a film."""
        return self.frames[::2]


@pytest.fixture(scope="module")
def beam(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    folder = tmp_path_factory.mktemp("beam")
    motion = experiment(RIG, "multisine", folder / "bag", seed=3, duration=SECONDS, rate=200.0)
    frames = list(film(Imager(scene_of(RIG), CAMERA, seed=3), motion))
    painted_layers(RIG, CAMERA).save(folder / "layers")
    return Filmed(bag=folder / "bag", layers=folder / "layers", frames=frames, motion=motion)


Video = Callable[..., Answer]


@pytest.fixture
def video(call: Callable[..., Answer], beam: Filmed, tmp_path: Path) -> Video:
    """The command on frames; layers of the beam and its bag, where nothing else is said."""

    def run(
        frames: Frames,
        bag: Path | None = beam.bag,
        layers: Path | None = beam.layers,
        suffix: str = ".mp4",
        crf: int = CRF,
    ) -> Answer:
        path = tmp_path / f"film{suffix}"
        write_film(path, frames, rate=30.0, crf=crf, preset="superfast")
        places = {"--out": tmp_path / "out", "--bag": bag, "--layers": layers}
        given = [word for name, place in places.items() if place for word in (name, str(place))]
        return call(app.main, "hybrid-sysid", "video", str(path), *given)

    return run


def _each(frames: Frames, change: Callable[[Picture], Picture]) -> Frames:
    return [(time, np.ascontiguousarray(change(picture))) for time, picture in frames]


def test_positions_of_a_film_come_into_the_bag(video: Video, beam: Filmed, tmp_path: Path) -> None:
    status, reported, error = video(beam.frames)
    assert status == 0, error
    assert "note" not in reported
    shift = re.search(r"shift[^-0-9]+(-?[0-9.]+)", reported)
    assert shift is not None
    assert float(shift[1]) == pytest.approx(-BEFORE, abs=1e-3)
    assert "/cam_beam/camera/joint_states" in bags.topics(tmp_path / "out")


@pytest.mark.parametrize(
    "pixels", [pytest.param(4, marks=pytest.mark.slow), 11]
)  # two degrees of a view of 60 are 11 of 320
def test_a_camera_that_looks_beside_is_reported(video: Video, beam: Filmed, tmp_path: Path, pixels: int) -> None:
    for axis in (0, 1):
        beside = _each(beam.fewer, partial(np.roll, shift=pixels, axis=axis))
        refused(video(beside), "the camera was moved", "--learn")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_camera_that_was_turned_is_reported_also_without_a_bag(video: Video, beam: Filmed, tmp_path: Path) -> None:
    def turned(picture: Picture) -> Picture:
        return np.asarray(Image.fromarray(picture).rotate(2.0, resample=Image.Resampling.BILINEAR))

    refused(video(_each(beam.fewer, turned), bag=None), "the camera was moved")
    assert not (tmp_path / "out").exists()


def test_a_film_that_loses_its_focus_is_reported(video: Video, beam: Filmed, tmp_path: Path) -> None:
    """For a third of a second; its joint is still seen to turn."""
    import cv2

    blurred = [
        (time, np.asarray(cv2.GaussianBlur(picture, (0, 0), 3.0)) if 3.0 < time < 3.34 else picture)
        for time, picture in beam.fewer
    ]
    refused(video(blurred), "is out of focus from 3", "cut it there")
    assert not (tmp_path / "out").exists()


def test_a_film_that_hangs_is_reported(video: Video, beam: Filmed, tmp_path: Path) -> None:
    frames = beam.fewer
    for k in range(50, 60):
        frames[k] = (frames[k][0], frames[50][1])
    refused(video(frames, crf=0), "stands still", "cut it there")  # without losses
    assert not (tmp_path / "out").exists()


def test_a_film_that_hangs_is_reported_also_where_its_codec_changes_the_picture(video: Video, beam: Filmed) -> None:
    """x264 writes one picture otherwise each time, and nothing but its joint tells that it stands."""
    frames = [(time, beam.frames[min(k, 100) if k < 120 else k][1]) for k, (time, _) in enumerate(beam.frames[:150])]
    refused(video(frames, bag=None, crf=20), "stands still, frozen, from 3.4", "cut it there")


def test_a_film_whose_light_goes_out_for_a_while_is_reported(video: Video, beam: Filmed, tmp_path: Path) -> None:
    """Of a twentieth of it a codec leaves something that passes for the joint."""
    frames = [(time, picture // 16 if 50 <= k < 60 else picture) for k, (time, picture) in enumerate(beam.fewer)]
    refused(video(frames, bag=None), "much darker than the rest", "from 3", "cut it there")
    assert not (tmp_path / "out").exists()


def test_a_black_film_is_reported(video: Video, beam: Filmed) -> None:
    refused(video(_each(beam.fewer, lambda picture: picture // 64)), "are black")


def test_a_dark_film_is_named_so_where_no_cut_helps_it(video: Video, beam: Filmed) -> None:
    frames = [(time, picture // (9 if k % 10 else 30)) for k, (time, picture) in enumerate(beam.fewer)]
    refused(video(frames), "too dark", "more light")


def test_black_pictures_are_reported_as_such(video: Video, beam: Filmed) -> None:
    frames = [
        (time, picture if k < 50 or k >= 55 else 0 * picture + 16) for k, (time, picture) in enumerate(beam.fewer)
    ]
    refused(video(frames), "is black", "cut it there")


def test_a_film_of_another_size_is_reported_by_its_name(video: Video, beam: Filmed, tmp_path: Path) -> None:
    smaller = _each(beam.fewer, lambda picture: picture[::2, ::2])
    refused(video(smaller), tmp_path / "film.mp4", "160x90", "320x180", "learn layers")
    assert not (tmp_path / "out").exists()


def test_a_film_whose_pictures_change_their_size_is_reported(call: Callable[..., Answer], tmp_path: Path) -> None:
    """As where a phone is turned meanwhile."""
    path, grain = tmp_path / "film.mjpeg", np.random.default_rng(0)
    with path.open("wb") as written:
        for size in ((136, 240), (240, 136)):
            for _ in range(20):
                Image.fromarray(grain.integers(0, 255, size, dtype=np.uint8)).save(written, "JPEG")
    run = call(app.main, "hybrid-sysid", "video", str(path), "--rig", RIG.name, "--out", str(tmp_path / "out"))
    refused(run, path, "change their size", "cut it there")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_layers_of_a_film_that_is_refused_are_not_written(video: Video, beam: Filmed, tmp_path: Path) -> None:
    bag, layers = tmp_path / "other", tmp_path / "layers"
    experiment(RIG, "multisine", bag, seed=9, duration=SECONDS, rate=200.0)
    refused(video(beam.fewer, bag=bag, layers=layers), tmp_path / "film.mp4", "motion is not the bag's")
    assert not layers.exists()


@pytest.mark.slow
def test_a_black_picture_does_not_hide_the_lamp(video: Video, beam: Filmed) -> None:
    frames = [(time, 0 * picture if k == 100 else picture) for k, (time, picture) in enumerate(beam.frames)]
    status, reported, error = video(frames)
    assert status == 0, error
    assert "1 of" in reported
    assert "lamp on" in reported


def test_the_motion_of_a_camera_that_shakes_is_taken_out(beam: Filmed, tmp_path: Path) -> None:
    """A pixel rms in each picture, and pushed by four for the rest of the film."""
    moves = np.random.default_rng(0).standard_normal((len(beam.frames), 2)).round().astype(int)
    moves[120:] += 4
    shaken = [
        (time, np.ascontiguousarray(np.roll(picture, move.tolist(), axis=(0, 1))))
        for (time, picture), move in zip(beam.frames, moves, strict=True)
    ]
    path, layers = tmp_path / "film.mp4", PictureLayers.load(beam.layers)
    write_film(path, shaken, rate=30.0, preset="superfast")
    footage = followed(FilmView(path=path).steadied(layers.background), AngleReader(layers), None)
    assert "the camera moves by" in " ".join(footage.remarks())
    true = np.interp(footage.seen - BEFORE, beam.motion.times, beam.motion.angles)
    assert np.degrees(np.std(footage.angles - true)) < 0.06  # .03 at twice the width


@pytest.mark.slow
@pytest.mark.parametrize("onset", [1.0, -0.6])
def test_a_lamp_at_another_time_is_noted(video: Video, beam: Filmed, onset: float) -> None:
    """The motion tells the time, the lamp whether it may be believed."""
    imager, motion = Imager(scene_of(RIG), CAMERA, seed=3), beam.motion
    times = np.append([-BEFORE - 1.0, -1e-9], motion.times)
    angles = np.append([motion.angles[0]] * 2, motion.angles)
    taken = [(time, imager.take(time - BEFORE, times, angles, onset=onset)) for time, _ in beam.frames]
    status, reported, error = video(taken)
    assert status == 0, error
    found = re.search(r"the lamp goes on ([0-9.]+) s (after|before) the bag begins", " ".join(reported.split()))
    assert found is not None
    assert (1 if found[2] == "after" else -1) * float(found[1]) == pytest.approx(
        onset, abs=0.02
    )  # between two exposures


@pytest.mark.slow
def test_times_that_run_as_no_clock_does_are_noted(video: Video, beam: Filmed) -> None:
    """31 pictures a second were written of a film of 30."""
    status, reported, error = video([(time * 30 / 31, picture) for time, picture in beam.frames])
    assert status == 0, error
    found = re.search(r"run ([\d.]+)% slow beside the bag's", " ".join(reported.split()))
    assert found is not None
    assert float(found[1]) == pytest.approx(100 * (31 / 30 - 1), abs=0.01)  # of a film of 6 s; 3.335 is on its edge


def test_times_that_a_film_rounds_are_no_other_rate(video: Video, beam: Filmed) -> None:
    """Matroska counts milliseconds: pictures of 30 a second are 33 or 34 apart."""
    status, reported, error = video(beam.frames, suffix=".mkv")
    assert status == 0, error
    assert "note" not in reported


@pytest.mark.slow
def test_a_film_whose_times_are_of_another_rate_is_reported(video: Video, beam: Filmed, tmp_path: Path) -> None:
    """25 pictures a second were written of a film of 30."""
    refused(video([(time * 30 / 25, picture) for time, picture in beam.frames]), "0.833 times as fast as the bag")
    assert not (tmp_path / "out").exists()


def test_a_head_with_another_rate_than_the_times_is_noted(video: Video, beam: Filmed) -> None:
    status, reported, error = video(beam.frames[::2], suffix=".mkv")  # 15 of the 30 that the head says
    assert status == 0, error
    assert "these count" in reported


@pytest.mark.slow
def test_another_bag_is_reported(video: Video, beam: Filmed, tmp_path: Path) -> None:
    experiment(RIG, "multisine", tmp_path / "other", seed=9, duration=SECONDS, rate=200.0)
    refused(video(beam.fewer, bag=tmp_path / "other"), tmp_path / "film.mp4", "motion is not the bag's")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wheel_motor", "flexible_joint"])
def test_a_film_of_another_rig_is_reported(video: Video, tmp_path: Path, name: str) -> None:
    times: Array = np.arange(0.0, SECONDS, 0.001, dtype=np.float64)
    imager, angles = Imager(scene_of(load(name)), CAMERA), 0.1 * np.sin(2.0 * np.pi * 0.5 * times)
    frames = [(time, imager.take(time, times, angles)) for time in np.arange(0.1, SECONDS - 0.1, 1.0 / 15.0).tolist()]
    refused(video(frames), "or it is another rig's film")
    refused(video(frames, bag=None, layers=None), "is it")  # nor can the beam's layers be learned from it
    assert not (tmp_path / "out").exists()
