"""What a film lacks is said before it is read; pivot, scene and marks can be given."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av", reason="needs the extra video")
pytest.importorskip("cv2", reason="needs the extra video")

import cv2

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.vision.camera.film import write_film
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager, Picture
from hybrid_sysid_ros.extensions.vision.commands import video
from hybrid_sysid_ros.extensions.vision.reading.camera_motion import CameraMotion
from hybrid_sysid_ros.extensions.vision.reading.feature_tracker import moved
from hybrid_sysid_ros.extensions.vision.reading.film_check import Finding, _pivot, film_check
from hybrid_sysid_ros.extensions.vision.reading.film_view import CLICKED, FilmView, squared, squaring
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import Answer, refused

RIG, CAMERA = load("cam_beam"), Camera(width=240, height=136)
TIMES: Array = np.arange(0.0, 6.0, 0.001, dtype=np.float64)
ANGLES: Array = 0.08 * np.sin(2.0 * np.pi * 0.6 * TIMES)
MARKS: Array = np.array([[40.0, 30.0], [200.0, 20.0], [210.0, 115.0], [35.0, 100.0]])


@pytest.fixture(scope="module")
def frames() -> list[tuple[float, Picture]]:
    imager = Imager(scene_of(RIG), CAMERA, seed=1)
    return [(time, imager.take(time, TIMES, ANGLES)) for time in (0.1 + np.arange(130) / 30.0).tolist()]


def _found(
    frames: list[tuple[float, Picture]], folder: Path, change: Callable[[Picture], Picture]
) -> dict[str, Finding]:
    path = folder / "film.mp4"
    write_film(path, [(time, change(picture)) for time, picture in frames], rate=30.0, preset="superfast")
    check = film_check(FilmView(path=path), exposure=0.008, marks=None)
    return {finding.what: finding for finding in check.findings}


def test_a_sound_film_lacks_only_marks(frames: list[tuple[float, Picture]], tmp_path: Path) -> None:
    found = _found(frames, tmp_path, lambda picture: picture)
    assert {what for what, finding in found.items() if finding.advice} == {"square view"}


@pytest.mark.parametrize(
    ("what", "change", "words"),
    [
        ("light", lambda picture: picture // 12, "dark"),
        ("motion", lambda picture: np.full_like(picture, 90), "move the rig"),
        ("motion", lambda picture: np.clip(254.0 + picture / 255.0, 0, 255).astype(np.uint8), "move the rig"),
        ("exposure", lambda picture: np.clip(254.0 + picture / 255.0, 0, 255).astype(np.uint8), "seen to move"),
    ],
)
def test_what_a_film_lacks_is_said(
    what: str, change: Callable[[Picture], Picture], words: str, frames: list[tuple[float, Picture]], tmp_path: Path
) -> None:
    assert words in _found(frames, tmp_path, change)[what].advice


def test_a_film_of_two_takes_is_said_to_be_cut(frames: list[tuple[float, Picture]], tmp_path: Path) -> None:
    takes = [(time, picture if number < 60 else 255 - picture) for number, (time, picture) in enumerate(frames)]
    found = _found(takes, tmp_path, lambda picture: picture)
    assert found["tripod"].bad
    assert f"from {frames[60][0]:.3g} s on" in found["tripod"].advice


def test_noise_at_rest_is_no_motion(tmp_path: Path) -> None:
    imager = Imager(scene_of(RIG), CAMERA, seed=1)
    rest = [(time, imager.take(1.0, TIMES, 0.0 * TIMES)) for time in (0.1 + np.arange(70) / 30.0).tolist()]
    found = _found(rest, tmp_path, lambda picture: picture)
    assert found["motion"].bad
    assert found["exposure"].found.startswith("unknown")


def test_a_shaking_camera_is_said(frames: list[tuple[float, Picture]], tmp_path: Path) -> None:
    random = np.random.default_rng(0)

    def shaken(picture: Picture) -> Picture:
        return np.ascontiguousarray(np.roll(picture, random.integers(-1, 2, 2).tolist(), axis=(0, 1)))

    assert "tripod" in _found(frames, tmp_path, shaken)["tripod"].advice


@pytest.mark.slow
def test_a_camera_that_swings_away_is_said_to_be_moved(tmp_path: Path) -> None:
    """A camera that pans by .35 rad sees what stands in perspective: no similarity explains it beside the middle."""
    rows, columns, focal = 136, 240, 216.0
    grain = np.random.default_rng(0).standard_normal((2 * rows, 3 * columns))
    wall = np.clip(128.0 + 400.0 * cv2.GaussianBlur(grain, (0, 0), 2.0), 0, 255).astype(np.uint8)
    lens = np.array([[focal, 0.0, columns / 2], [0.0, focal, rows / 2], [0.0, 0.0, 1.0]])
    middle = np.array([[1.0, 0.0, -columns], [0.0, 1.0, -rows / 2], [0.0, 0.0, 1.0]])
    seen = []
    for number, pan in enumerate(np.linspace(-0.35, 0.35, 120).tolist()):
        turn = lens @ cv2.Rodrigues(np.array([0.0, pan, 0.0]))[0] @ np.linalg.inv(lens)
        seen.append((number / 30.0, np.asarray(cv2.warpPerspective(wall, turn @ middle, (columns, rows)), np.uint8)))
    write_film(tmp_path / "film.mp4", seen, rate=30.0, preset="superfast")
    with pytest.raises(UserError, match="the camera was moved"):
        FilmView(path=tmp_path / "film.mp4").steadied()


def test_a_page_is_written_to_click_on(
    call: Callable[..., Answer], frames: list[tuple[float, Picture]], tmp_path: Path
) -> None:
    write_film(tmp_path / "film.mp4", frames, rate=30.0, preset="superfast")
    run = partial(call, app.main, "hybrid-sysid", "video", str(tmp_path / "film.mp4"))
    status, reported, error = run("--check")
    assert status == 0, error
    assert "square view" in reported
    assert 'id="clicks"' in (tmp_path / "film.check.html").read_text(encoding="utf-8")
    refused(run(), "--out", "--check")
    refused(run("--out", str(tmp_path / "out"), "--pivot", "middle"), "--pivot middle", "two numbers")
    scene = tmp_path / "scene.yaml"
    for marks, words in (
        ("[1, 2]", "four corners"),
        ("[.1, .1, .2, .1, .2, .2, .1, .2]", "width and height"),
        ("[.1, .2, .2, .2, .2, .1, .1, .1]\nrectangle: [2, 1]", "clockwise"),
    ):
        scene.write_text(f"joint: beam\npivot: [0.5, 0.29]\nsprite: [{{disc: 0.1}}]\nmarks: {marks}\n")
        refused(run("--out", str(tmp_path / "out"), "--scene", str(scene)), "scene.yaml", words)
    scene.write_text("joint: bem\npivot: [0.5, 0.29]\nsprite: [{disc: 0.1}]\n")
    refused(run("--out", str(tmp_path / "out"), "--scene", str(scene)), "scene.yaml", "no joint that moves")


@pytest.mark.parametrize(("clicked", "advice"), [(None, ""), ((0.51, 0.44), ""), ((0.5, 0.36), "26 pixels beside")])
def test_what_turns_elsewhere_than_where_one_clicked_is_said(clicked: tuple[float, float] | None, advice: str) -> None:
    """Of two that turn, the place that both have in common is neither's."""
    found = _pivot((np.array([0.5, 0.44]), np.array([0.001, 0.002])), clicked, 320)
    assert found.advice[: len(advice) or None] == advice


def test_a_pivot_that_was_clicked_is_looked_for_nowhere_else(
    call: Callable[..., Answer], frames: list[tuple[float, Picture]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock on the wall turns, too, and whoever clicks the joint means that."""

    def as_it_is(view: FilmView, background: object = None) -> FilmView:
        return view

    def looked_for(view: FilmView, rig: Rig) -> tuple[Rig, float]:
        raise UserError("looked for")

    def learned(film: Film, rig: Rig, **said: object) -> None:
        raise UserError(f"learned about {scene_of(rig).pivot[0]:g}")

    monkeypatch.setattr(FilmView, "steadied", as_it_is)
    monkeypatch.setattr(video, "with_turning_point", looked_for)
    monkeypatch.setattr(video, "learn", learned)
    write_film(tmp_path / "film.mp4", frames[:40], rate=30.0, preset="superfast")
    scene = tmp_path / "scene.yaml"
    scene.write_text("joint: beam\npivot: [0.4, 0.29]\nsprite: [{disc: 0.1}]\n")
    run = partial(call, app.main, "hybrid-sysid", "video", str(tmp_path / "film.mp4"), "--out", str(tmp_path / "out"))
    refused(run(), "looked for")
    refused(run("--scene", str(scene)), "learned about 0.4")


def test_marks_that_are_clicked_beside_make_as_large_a_scale_as_is_said() -> None:
    """Against the angles of a bar's two ends, seen from the side, and put right by marks that are off by chance."""
    square, random = squaring(MARKS, (16.0, 9.0)), np.random.default_rng(0)
    beside = CLICKED * np.eye(8).reshape(8, 4, 2)
    squares = tuple(squaring(MARKS + off, (16.0, 9.0)) for off in beside)
    pivot, angles = (160.0, 80.0), 0.3 + 0.05 * np.sin(np.arange(20.0))
    arm = 60.0 * np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    scales = []
    for _ in range(200):
        clicked = squaring(MARKS + CLICKED * random.standard_normal((4, 2)), (16.0, 9.0)) @ np.linalg.inv(square)
        ends = [moved(clicked[None], np.array(pivot) + sign * arm)[0] for sign in (1.0, -1.0)]
        x, y = (ends[0] - ends[1]).T
        scales.append(np.polyfit(angles, np.arctan2(-y, x), 1)[0])
    stated = FilmView(path=Path("film.mp4"), square=square, squares=squares).scale_deviation(pivot, angles)
    assert np.std(scales) == pytest.approx(stated, rel=0.15)


def test_four_marks_make_a_view_square() -> None:
    """A picture that is seen from the side, and put right, is the one that is seen squarely."""
    square = squaring(MARKS, (16.0, 9.0))
    corners = cv2.perspectiveTransform(MARKS[:, None], square)[:, 0]
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    assert sides == pytest.approx([sides[0], sides[0] * 9 / 16] * 2, rel=1e-4)
    upright = Imager(scene_of(RIG), Camera(width=240, height=136, noise=0.0)).take(1.0, TIMES, ANGLES)
    oblique = squared(upright, np.linalg.inv(square).astype(np.float64))
    inside = np.s_[45:90, 60:180]
    assert np.abs(squared(oblique, square)[inside].astype(float) - upright[inside]).mean() < 4.0
    with pytest.raises(UserError, match="clockwise"):
        squaring(MARKS[::-1], (1.0, 1.0))


def test_a_camera_that_moved_is_taken_out_with_the_time_of_the_films_own_rows() -> None:
    """What it did not show is as in the reference, and moves with nothing."""
    reference = np.random.default_rng(0).integers(0, 200, (60, 80), dtype=np.uint8)
    poses = np.tile(np.eye(3), (2, 1, 1))
    poses[1, :2, 2] = 4.0, 3.0  # what was at a place is 4 pixels to the right and 3 below
    motion = CameraMotion(
        poses=poses, shake=3.0, farthest=5.0, roll=0.0, deviation=0.01, roll_deviation=1e-5, reference=reference,
        features=np.zeros((0, 2), dtype=np.float32), torn=np.zeros(2, dtype=bool),
    )  # fmt: skip
    shifted = np.zeros_like(reference)
    shifted[3:, 4:] = reference[:-3, :-4]
    assert (motion.taken_out(shifted, 1)[:-4, :-5] == reference[:-4, :-5]).all()
    assert (motion.taken_out(shifted, 1)[-2:] == reference[-2:]).all()
    view = FilmView(path=Path("film.mp4"), motion=motion)
    assert view.film_rows(40.0, np.array([20.0, 20.0])).tolist() == [20.0, 23.0]
