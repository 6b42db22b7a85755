"""Run the studies of the camera: python -m benchmarks.camera [angles] [timing] [friction] [loop] [images] [coding]."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rich.table import Table

from benchmarks import parts, result
from benchmarks.camera import angles, coding, friction, loop, timing
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.extras import extra


def _angles(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = angles.measured(rig)
    return found, [angles.table(found)]


def _timing(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = timing.measured(rig)
    return found, [timing.table(found)]


def _friction(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = friction.measured(rig)
    return found, [friction.table(found)]


def _loop(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = loop.measured(rig)
    return found, [loop.table(found)]


def _images(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    with extra("train"):
        from benchmarks.camera import images
    found = images.measured(rig)
    return found, [images.table(found)]


def _coding(rig: Rig) -> tuple[dict[str, Any], Sequence[Table]]:
    found = coding.measured(rig)
    return found, [coding.table(found)]


PARTS = {
    "angles": _angles, "timing": _timing, "friction": _friction, "loop": _loop, "images": _images, "coding": _coding,
}  # fmt: skip
main = partial(parts.run, "cam_beam", PARTS)

if __name__ == "__main__":
    result.run(main)
