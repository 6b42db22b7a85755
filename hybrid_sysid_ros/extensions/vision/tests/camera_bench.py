"""Layers of a rig's scene as it is painted: what learning must come near to."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.extensions.vision.camera.painting import Grid, grid_around, painted
from hybrid_sysid_ros.extensions.vision.reading.layers import Geometry, PictureLayers
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.rig import Rig


def painted_layers(rig: Rig, camera: Camera, *, low: float = -0.15, high: float = 0.15) -> PictureLayers:
    scene, width, pixel = scene_of(rig), camera.width, 1.0 / camera.width
    whole = Grid(start=(pixel / 2, pixel / 2), pitch=pixel, shape=(camera.height, width))
    cover, background = painted(scene.background, whole)
    grid = grid_around(scene.sprite, pixel)
    alpha, texture = painted(scene.sprite, grid)
    geometry = Geometry(
        rig=rig.name,
        joint=scene.joint,
        pivot_x=scene.pivot[0] * width - 0.5,
        pivot_y=scene.pivot[1] * width - 0.5,
        first_u=grid.start[0] * width,
        first_v=grid.start[1] * width,
        low=low + scene.roll,
        high=high + scene.roll,
        noise=max(camera.noise, 0.5),
        readout=camera.readout,
        zero=scene.roll,
    )
    return PictureLayers(
        geometry=geometry,
        background=(255 * (scene.shade * (1.0 - cover) + background)).astype(np.float32),
        alpha=alpha.astype(np.float32),
        texture=(255 * texture).astype(np.float32),
    )
