"""A scene of a rig: what a camera in front of it sees, as patches of grey: what stands, and what one joint turns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built, read_mapping, section


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A box or a disc of one grey, once or in rows. Lengths are in widths of the picture, x to the right, y down.

    Raises UserError where it is neither, or both.
    """

    box: tuple[float, ...] = ()
    """Width and height."""
    disc: float = 0.0
    """Radius."""
    at: tuple[float, ...] = (0.0, 0.0)
    """The middle of the first one."""
    shade: float = 0.5
    """Grey, from 0 (black) to 1 (white)."""
    times: tuple[int, ...] = (1, 1)
    """How often it is repeated along x and along y,"""
    pitch: tuple[float, ...] = (0.0, 0.0)
    """at which distances,"""
    stagger: float = 0.0
    """every second row shifted by so much along x,"""
    vary: float = 0.0
    """each with another grey, +-."""
    turned: tuple[float, ...] = (0.0,)
    """Angles [rad] by which it is turned about the origin, one each time it is drawn."""

    def __post_init__(self) -> None:
        for name, count in (("at", 2), ("times", 2), ("pitch", 2), *([("box", 2)] if self.box else [])):
            if len(getattr(self, name)) != count:
                raise UserError(f"{name} has {len(getattr(self, name))} numbers: it needs x and y")
        if bool(self.box) == bool(self.disc) or min((*self.box, self.disc)) < 0.0:
            raise UserError("a patch is a box, [width, height], or a disc, its radius, above 0")
        if not (0.0 <= self.shade <= 1.0 and min(self.times) >= 1):
            raise UserError("shade goes from 0 to 1, and times are 1 or more")

    @property
    def reach(self) -> float:
        """Largest distance from the origin."""
        half = max(self.disc, math.hypot(*self.box) / 2)
        x, y = (at + (n - 1) * step for at, n, step in zip(self.at, self.times, self.pitch, strict=True))
        return max(math.hypot(*self.at), math.hypot(x, y)) + half


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A light that goes on when an experiment begins; in widths of the picture."""

    at: tuple[float, ...]
    radius: float
    shade: float = 1.0
    """Grey that it adds when it is lit."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A picture of a rig; x = pivot + R(angle of the joint) u puts what turns (u: its patches' own coordinates)."""

    joint: str
    """The joint that turns the sprite; counter-clockwise, as all angles."""
    pivot: tuple[float, ...]
    """About which it turns, in widths of the picture from its upper left corner."""
    sprite: tuple[Patch, ...]
    """What turns, later patches before earlier ones; its x is to the right where the joint is at 0."""
    background: tuple[Patch, ...] = ()
    """What stands, from the upper left corner."""
    shade: float = 0.5
    """Of the picture where there is no patch."""
    roll: float = 0.0
    """Of the camera about its axis, clockwise, so that all angles look larger by it [rad]."""
    lamp: Lamp | None = None
    marks: tuple[float, ...] = ()
    """x and y of the four corners of a rectangle in the plane of the motion, from the upper left one clockwise, by
    which it is seen squarely; pivot and lamp are where they are seen before that."""
    rectangle: tuple[float, ...] = ()
    """Its width and height in any unit."""

    def __post_init__(self) -> None:
        if not self.sprite:
            raise UserError("sprite has no patch: nothing would move")
        if len(self.pivot) != 2:
            raise UserError(f"pivot has {len(self.pivot)} numbers: it needs x and y")
        if len(self.marks) not in (0, 8):
            raise UserError(f"marks has {len(self.marks)} numbers: it needs x and y of four corners, or none")
        if self.marks and not (len(self.rectangle) == 2 and min(self.rectangle) > 0.0):
            raise UserError("rectangle needs the true width and height of what the marks are the corners of, above 0")


def with_scene(rig: Rig, path: Path) -> Rig:
    """The rig with the scene of a file, a section ``scene`` or what stands in one, in the place of its own.

    Raises UserError where the file can't be read, or describes no scene of the rig.
    """
    content = read_mapping(path)
    found = content.get("scene", content)
    _scene(rig, found, f"{path}: scene")
    return replace(rig, content={**rig.content, "scene": found})


def with_pivot(rig: Rig, pivot: tuple[float, float]) -> Rig:
    """The rig with another pivot of its scene [widths]. Raises UserError as :func:`scene_of` does."""
    scene_of(rig)
    return replace(rig, content={**rig.content, "scene": {**rig.content["scene"], "pivot": list(pivot)}})


def scene_of(rig: Rig) -> Scene:
    """What a camera sees of a rig.

    Raises UserError where the rig's file has no section ``scene``, or names in it what is not there.
    """
    if not has_scene(rig):
        raise UserError(
            f"{rig.file}: has no section scene: it says what a camera sees of the rig (docs/camera.md); click one on "
            "the page of hybrid-sysid video FILM --check, and give it (--scene)"
        )
    return _scene(rig, section(rig.content, "scene", str(rig.file)), f"{rig.file}: scene")


def _scene(rig: Rig, content: object, where: str) -> Scene:
    """The scene of a rig that a section describes. where: the file and the section, for errors."""
    scene = built(Scene, content, where)
    if scene.joint not in turning(rig):
        raise UserError(f"{where}.joint: {scene.joint!r} is no joint that moves; known are {', '.join(turning(rig))}")
    return scene


def turning(rig: Rig) -> list[str]:
    """Joints of a rig that move."""
    return [name for name, joint in rig.joints.joints.items() if joint.position or joint.velocity]


def has_scene(rig: Rig) -> bool:
    """Whether there is a picture of a rig."""
    return "scene" in rig.content
