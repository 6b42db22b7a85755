"""Camera loop: the parameters of the nodes of a loop that a camera alone closes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.parameters import defaults, shipped
from hybrid_sysid_ros.support.errors import UserError

BELIEVED = 0.07
"""Deviation of a frame that estimators go by, in pixels of the sprite's end: some four times what it is in sound
pictures, for what layers do not explain."""


def frame_noise(rig: Rig, width: int) -> float:
    """Deviation of a position read from a picture ``width`` pixels wide, in the unit of the first output.

    Raises UserError where no picture shows the rig's first output.
    """
    scene, first = scene_of(rig), rig.system.outputs[0].name
    if rig.joints.joints[scene.joint].position != first:
        raise UserError(f"{rig.file}: a camera sees the position of {scene.joint}, but the first output is {first}")
    reach = width * max(patch.reach for patch in scene.sprite)
    return float(BELIEVED / reach / rig.display[0].scale)


def parameters(rig: Rig, layers: Path | str = "") -> dict[str, dict[str, Any]]:
    """Parameters by node and name, where a camera is the only sensor: camera and vision, and what they change in plant
    and estimator. layers: folder of the layers, the shipped ones by default.

    Raises UserError where no picture shows the rig's first output, no layers are there, or what reads pictures is not
    installed.
    """
    jpeg.check_available()
    camera = defaults(rig, "camera")
    noise = frame_noise(rig, camera["width"])
    folder = Path(layers or shipped(rig.name, "layers"))
    return {
        "plant": {"sensor_out": [1.0] * len(rig.sensors), "camera_rate": camera["rate"]},
        "estimator": {"camera_noise": noise},
        "camera": {},
        "vision": {"layers": str(folder)},
    }
