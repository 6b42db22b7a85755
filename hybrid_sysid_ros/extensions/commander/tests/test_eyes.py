"""Goals that are pictures: read, checked and simulated as every command is, or refused in a line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("PIL", reason="needs the extra video")
pytest.importorskip("hybrid_sysid_ros.extensions.vision", reason="needs the extension vision")

from hybrid_sysid_ros.extensions.commander.language.rehearsal import Rehearsal
from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.rigs.rig import load

RIG = load("cam_beam")
VOLT = RIG.display[0].scale


def picture(angle: float, **camera: int | float) -> np.ndarray:
    imager = Imager(scene_of(RIG), Camera(**camera))  # type: ignore[arg-type]
    return imager.take(0.0, np.array([-1.0, 1.0]), np.full(2, angle))


@pytest.fixture(scope="module")
def desk(model_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Rehearsal:
    """In a folder of pictures."""
    folder = tmp_path_factory.mktemp("goals")
    painted_layers(RIG, Camera(), low=-0.25, high=0.25).save(folder / "layers")
    pictures = {
        "goal": picture(2.0 * VOLT),
        "far": picture(9.5 * VOLT),
        "small": picture(0.0, width=320, height=180),
        "black": picture(0.0, gain=0.0),
        "moved": np.roll(picture(VOLT), (7, 11), axis=(0, 1)),
    }
    for name, shown in pictures.items():
        (folder / f"{name}.jpg").write_bytes(jpeg.encoded(shown, 80))
    (folder / "text.jpg").write_text("import os")
    return Rehearsal.of(RIG, model=model_folder, policy="exact", folder=str(folder), layers=folder / "layers")


@pytest.mark.parametrize(
    "text", ["make it look like goal.jpg", "look like 'goal.jpg' slowly", "match the picture goal.jpg"]
)
def test_a_picture_is_a_goal(desk: Rehearsal, text: str) -> None:
    reply = desk.check(text)
    assert reply.accepted, reply.line
    goal = float(reply.line.split("to ")[1].split(" V")[0])
    assert goal == pytest.approx(2.0, abs=0.02)
    assert "goal.jpg" in reply.line
    assert math.isfinite(reply.values["peak drive [V]"])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("look like far.jpg", "out of reach"),
        ("look like small.jpg", "320x180"),
        ("look like black.jpg", "does not show the beam"),
        ("look like moved.jpg", "moved"),
        ("look like text.jpg", "no JPEG or PNG"),
        ("look like '../goal.jpg'", "outside"),
        ("look like nothing.png", "no such file"),
        ("look like moves.csv", "name one picture"),
        ("look like", "name one picture"),
        ("look like goal.jpg quickly in 3 s", "contradict"),
        ("hold goal.jpg", "look like goal.jpg"),
    ],
)
def test_what_no_picture_shows_is_refused_in_a_line(desk: Rehearsal, text: str, why: str) -> None:
    reply = desk.check(text)
    assert not reply.accepted
    assert why in reply.line
    assert "\n" not in reply.line
