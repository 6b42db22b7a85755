"""What moves in a film tells about where it turns, wherever the rig's scene says it does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av", reason="needs the extra video")
pytest.importorskip("cv2", reason="needs the extra video")

import cv2

from hybrid_sysid_ros.extensions.vision.camera.film import write_film
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager, Picture
from hybrid_sysid_ros.extensions.vision.reading.film_view import FilmView
from hybrid_sysid_ros.extensions.vision.reading.turning_point import turning_point, with_turning_point
from hybrid_sysid_ros.extensions.vision.scene import scene_of, with_pivot
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array

TIMES: Array = np.arange(0.0, 6.0, 0.001, dtype=np.float64)


def _film(folder: Path, pictures: list[Picture]) -> FilmView:
    path = folder / "film.mp4"
    write_film(path, [(k / 30.0, picture) for k, picture in enumerate(pictures)], rate=30.0, preset="superfast")
    return FilmView(path=path)


@pytest.mark.parametrize("pivot", [(0.5, 0.29), (0.35, 0.45)])
def test_the_pivot_is_found_where_the_bar_turns(pivot: tuple[float, float], tmp_path: Path) -> None:
    rig = load("cam_beam")
    imager = Imager(scene_of(with_pivot(rig, pivot)), Camera(width=240, height=136), seed=1)
    angles: Array = 0.08 * np.sin(2.0 * np.pi * 0.6 * TIMES)
    view = _film(tmp_path, [imager.take(time, TIMES, angles) for time in (0.1 + np.arange(130) / 30.0).tolist()])
    found = turning_point(view)
    assert found is not None
    assert found[0] == pytest.approx(pivot, abs=0.015)
    moved, far = with_turning_point(view, rig)
    assert (far > 0.0) == (pivot != (0.5, 0.29))
    assert scene_of(moved).pivot == pytest.approx(pivot, abs=0.015)


def test_what_passes_and_does_not_turn_moves_no_pivot(tmp_path: Path) -> None:
    """A person who walks by before an even wall."""
    pictures = []
    for k in range(80):
        picture = np.full((136, 240), 90, dtype=np.uint8)
        cv2.ellipse(picture, (10 + 3 * k, 70), (12, 40), 0, 0, 360, 200, -1, cv2.LINE_AA)
        pictures.append(picture)
    rig = load("cam_beam")
    assert with_turning_point(_film(tmp_path, pictures), rig) == (rig, 0.0)
