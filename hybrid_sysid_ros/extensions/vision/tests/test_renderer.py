"""Layers that draw: the picture that the simulated camera takes, and likeness by its published formula."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.reading.likeness import structural_similarity
from hybrid_sysid_ros.extensions.vision.reading.renderer import LayerRenderer, Renderer
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.arrays import Array

CAMERA = Camera(width=320, height=180, noise=0.0)
TIMES: Array = np.arange(-0.1, 0.1, 0.001, dtype=np.float64)


@pytest.mark.parametrize("speed", [0.0, 1.5])
def test_layers_draw_what_the_camera_takes(speed: float) -> None:
    rig = load("cam_beam")
    angles = 0.03 + speed * TIMES
    renderers: list[Renderer] = [
        Imager(scene_of(rig), CAMERA),
        LayerRenderer(painted_layers(rig, CAMERA), exposure=CAMERA.exposure),
    ]
    taken, drawn = (renderer.take(0.0, TIMES, angles).astype(float) for renderer in renderers)
    elsewhere = renderers[1].take(0.0, TIMES, angles + 0.02).astype(float)
    assert np.sqrt(np.mean((drawn - taken) ** 2)) < 2.0  # painted at half the pitch, drawn at the whole one
    assert np.sqrt(np.mean((elsewhere - taken) ** 2)) > 10.0


def test_likeness_is_that_of_the_formula() -> None:
    everywhere = np.ones((40, 60), dtype=bool)
    noise = np.random.default_rng(0).uniform(0.0, 255.0, everywhere.shape)
    assert structural_similarity(noise, noise, everywhere) == pytest.approx(1.0)
    plain, other = np.full(everywhere.shape, 100.0), np.full(everywhere.shape, 140.0)
    c1 = (0.01 * 255.0) ** 2  # of plain pictures only means are left
    wanted = (2.0 * 100.0 * 140.0 + c1) / (100.0**2 + 140.0**2 + c1)
    assert structural_similarity(plain, other, everywhere) == pytest.approx(wanted)
    mirrored = 255.0 - noise  # the covariance turns its sign
    assert structural_similarity(noise, mirrored, everywhere) < -0.5
