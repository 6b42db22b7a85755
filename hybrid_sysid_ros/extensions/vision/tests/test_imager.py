"""The simulated camera against what optics and geometry say in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.camera.painting import Grid, painted
from hybrid_sysid_ros.extensions.vision.scene import Lamp, Patch, Scene, scene_of
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

TIMES: Array = np.arange(0.0, 4.0, 0.001, dtype=np.float64)
BAR = Scene(
    joint="bar",
    pivot=(0.5, 0.25),
    shade=0.2,
    sprite=(Patch(box=(0.8, 0.02), shade=1.0),),
    lamp=Lamp(at=(0.1, 0.45), radius=0.02, shade=0.5),
)
QUIET = {"noise": 0.0}


def _picture(angles: Array, *, time: float = 2.0, scene: Scene = BAR, **camera: float) -> Array:
    imager = Imager(scene, Camera(**{**QUIET, **camera}))  # type: ignore[arg-type]
    return imager.take(time, TIMES, angles, onset=math.inf).astype(float)


def _bright_angle(picture: Array, shade: float = 0.2) -> float:
    """Counter-clockwise direction of what is brighter than the background, by its second moments about the pivot."""
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    x, y = x - (0.5 * picture.shape[1] - 0.5), (0.25 * picture.shape[1] - 0.5) - y
    w = np.maximum(picture - 255 * shade - 1.0, 0.0)
    return float(0.5 * math.atan2(2.0 * (w * x * y).sum(), (w * (x * x - y * y)).sum()))


def test_a_painted_box_covers_its_area() -> None:
    grid = Grid(start=(0.005, 0.005), pitch=0.01, shape=(60, 100))
    alpha, texture = painted([Patch(box=(0.333, 0.017), at=(0.4, 0.2), shade=0.5)], grid)
    assert alpha.sum() * grid.pitch**2 == pytest.approx(0.333 * 0.017, rel=1e-12)
    assert texture.sum() == pytest.approx(0.5 * alpha.sum())


@pytest.mark.parametrize("angle", [-0.11, -0.02, 0.0, 0.013, 0.1])
def test_the_sprite_stands_at_the_angle_of_its_joint(angle: float) -> None:
    assert _bright_angle(_picture(np.full(len(TIMES), angle))) == pytest.approx(angle, abs=2e-4)


def test_roll_turns_the_sprite_further() -> None:
    rolled = Scene(joint="bar", pivot=(0.5, 0.25), shade=0.2, sprite=BAR.sprite, roll=0.05)
    assert _bright_angle(_picture(np.zeros(len(TIMES)), scene=rolled)) == pytest.approx(0.05, abs=2e-4)


def test_an_exposure_shows_the_mean_of_its_angles() -> None:
    rate, exposure = 3.0, 0.02
    picture = _picture(rate * (TIMES - 2.0) + 0.03, exposure=exposure, readout=0.0)
    assert _bright_angle(picture) == pytest.approx(0.03, abs=5e-4)
    sharp = _picture(np.full(len(TIMES), 0.03))
    # the bar's end sweeps rate * exposure * half its length
    end = 560
    smeared, edge = (picture[:, end] > 53).sum(), (sharp[:, end] > 53).sum()
    assert smeared - edge == pytest.approx(rate * exposure * (end - 319.5), abs=2.0)


def test_rows_are_exposed_one_after_the_other() -> None:
    """A bar through the pivot row shows the angle of that row's time, not of the picture's middle."""
    readout, rate = 0.016, 1.0
    picture = _picture(rate * (TIMES - 2.0), readout=readout)
    pivot_row, rows = 0.25 * 640 - 0.5, 360
    late = (pivot_row - (rows - 1) / 2) * readout / rows
    assert _bright_angle(picture) == pytest.approx(rate * late, abs=3e-4)


def test_a_lamp_is_lit_for_its_share_of_the_exposure() -> None:
    imager = Imager(BAR, Camera(noise=0.0, readout=0.0, exposure=0.01))
    lit = imager.take(2.0, TIMES, np.zeros(len(TIMES)), onset=2.0025)
    assert float(lit[288, 64]) == pytest.approx(255 * (0.2 + 0.5 * 0.25), abs=1.0)


def test_noise_has_the_deviation_that_was_asked_for() -> None:
    picture = _picture(np.zeros(len(TIMES)), noise=4.0)
    corner = picture[:60, :]
    assert corner.std() == pytest.approx(math.hypot(4.0, 1 / math.sqrt(12)), rel=0.02)
    assert corner.mean() == pytest.approx(51.0, abs=0.1)


@pytest.mark.parametrize("name", ["cam_beam", "flexible_joint", "wheel_motor", "drill_string"])
def test_rigs_have_a_picture_in_which_their_joint_moves(name: str) -> None:
    scene = scene_of(load(name))
    one, other = (_picture(np.full(len(TIMES), angle), scene=scene) for angle in (0.0, 0.1))
    assert (np.abs(one - other) > 20).mean() > 0.002


def test_a_rig_without_a_scene_says_so() -> None:
    with pytest.raises(UserError, match="no section scene"):
        scene_of(load("winged_cone"))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"exposure": 0.05}, "shorter than a period"), ({"width": 4}, "too small"), ({"rate": 0.0}, "above 0")],
)
def test_impossible_cameras_are_refused(wrong: dict[str, float], words: str) -> None:
    with pytest.raises(UserError, match=words):
        Camera(**wrong)  # type: ignore[arg-type]
