"""A cost in the picture: its output is the root of the pixels' difference, and its loop ends at the picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("PIL", reason="needs the extra video")

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager, Picture
from hybrid_sysid_ros.extensions.vision.goal.goal_picture import goal_of
from hybrid_sysid_ros.extensions.vision.goal.picture_mpc import OFFSETS
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.renderer import LayerRenderer
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.runtime.simulated_loop import predicted_plant, simulated_loop
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused

RIG = load("cam_beam")
VOLT = RIG.display[0].scale
STILL = np.array([-1.0, 1.0])


def taken(volts: float, **camera: Any) -> Picture:
    return Imager(scene_of(RIG), Camera(**camera)).take(0.0, STILL, np.full(2, volts * VOLT))


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("goal")
    painted_layers(RIG, Camera(), low=-0.25, high=0.25).save(folder / "layers")
    (folder / "goal.jpg").write_bytes(jpeg.encoded(taken(2.2), 90))
    (folder / "far.jpg").write_bytes(jpeg.encoded(taken(9.5), 90))
    given = {"policy": "exact", "lockstep": True, "picture": str(folder / "goal.jpg"), "layers": str(folder / "layers")}
    return {**configuration.defaults(RIG, "controller"), **given}


@pytest.fixture(scope="module")
def model(model_folder: Path) -> Model:
    return load_model(model_folder)


def test_its_square_is_the_difference_of_the_pixels(model: Model, settings: dict[str, Any]) -> None:
    system = goal_of(RIG, model.system, settings)
    assert system.best == pytest.approx(2.2 * VOLT, abs=0.03 * VOLT)
    layers = PictureLayers.load(settings["layers"])
    band, renderer = AngleReader(layers).swept, LayerRenderer(layers, exposure=0.008)
    goal = jpeg.opened(Path(settings["picture"])).astype(float)

    def apart(position: float) -> float:
        return float(np.mean((renderer.take(0.0, STILL, np.full(2, position)) - goal)[band] ** 2))

    knots = (system.best + system.span * OFFSETS)[[4, 9, 15, 20]]
    found = [float(output_of(system, np.array([knot, 0.0]), np.zeros(1))[0]) for knot in knots.tolist()]
    wanted = np.array([apart(knot) - apart(system.best) for knot in knots.tolist()])
    assert np.sign(found).tolist() == [-1.0, -1.0, 1.0, 1.0]
    np.testing.assert_allclose(np.square(found) / found[0] ** 2, wanted / wanted[0], rtol=1e-6)


def test_the_loop_ends_at_the_picture(model: Model, settings: dict[str, Any]) -> None:
    made = controller_of(RIG, model, settings)
    loop = simulated_loop(
        RIG, model, made.controller, lambda t: np.zeros((*np.shape(t), 1)), duration=1.0,
        plant=predicted_plant(RIG, model.system),
    )  # fmt: skip
    shown = loop.outputs[:, 0] / VOLT
    assert np.abs(shown[-20:] - 2.2).max() < 0.05
    assert np.abs(loop.inputs).max() <= RIG.limits[1][0] + 1e-9


def test_what_no_controller_can_do_is_refused(model: Model, settings: dict[str, Any]) -> None:
    folder = Path(settings["picture"]).parent
    with pytest.raises(UserError, match="out of reach"):
        goal_of(RIG, model.system, {**settings, "picture": str(folder / "far.jpg")})
    with pytest.raises(UserError, match="only the exact MPC weighs pictures"):
        controller_of(RIG, model, {**settings, "policy": "supervised"})
    wheel = load("wheel_motor")
    with pytest.raises(UserError, match="the layers are of the rig cam_beam"):
        goal_of(wheel, wheel.system, settings)


def test_a_run_looks_at_its_picture_before_anything_starts(call: Any, tmp_path: Path) -> None:
    (tmp_path / "text.jpg").write_text("no picture")
    for name, why in {"text.jpg": "can't be identified", "none.jpg": "No such file"}.items():
        answer = call(
            app.main,
            "hybrid-sysid",
            "run",
            "--camera",
            "--picture",
            str(tmp_path / name),
            "--bag",
            str(tmp_path / "bag"),
        )
        refused(answer, name, "no JPEG or PNG that can be read", why)
    assert not (tmp_path / "bag").exists()
