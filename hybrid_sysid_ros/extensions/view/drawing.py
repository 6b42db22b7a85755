"""A drawing of a rig: bodies of simple shapes that its joints move, for the live view and for its URDF."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from hybrid_sysid_ros.rigs.joints import Joint
from hybrid_sysid_ros.rigs.rig import BEYOND, Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built, section

BASE, GROUND = "base", "ground"
"""Links of the URDF: its root, and what carries the bodies that stand on no other."""
DEPTH = 0.03
"""Of the bodies, across the plane of the drawing [m]."""
DIAL, APART = 0.1, 0.3  # m: radius of a dial, and from one to the next
GREY, COLOUR = "0.55 0.57 0.60 1", "0.16 0.44 0.75 1"  # of what stands, and of what moves


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A box or a disc. Raises UserError where it is neither, or both."""

    box: tuple[float, ...] = ()
    """Width and height [m]."""
    disc: float = 0.0
    """Radius [m]."""
    at: tuple[float, ...] = (0.0, 0.0)
    """Its middle, in the frame of its body [m]."""

    def __post_init__(self) -> None:
        _check_pair("at", self.at)
        if self.box:
            _check_pair("box", self.box)
        if bool(self.box) == bool(self.disc) or min((*self.box, self.disc)) < 0.0:
            raise UserError("a shape is a box, [width, height], or a disc, its radius, above 0")

    @property
    def half(self) -> tuple[float, float]:
        """Half its width and height [m]."""
        return (self.box[0] / 2, self.box[1] / 2) if self.box else (self.disc, self.disc)


@dataclass(frozen=True, kw_only=True)
class DrawnBody:
    """What moves as one: x is to the right, y up, angles are counter-clockwise."""

    shapes: tuple[Shape, ...]
    joint: str = ""
    """The joint whose position turns it about its origin; "" for none."""
    slides: bool = False
    """The joint moves it along x instead."""
    on: str = ""
    """The body that carries it; "" for the ground."""
    at: tuple[float, ...] = (0.0, 0.0)
    """Its origin, in the frame of the body that carries it [m]."""

    def __post_init__(self) -> None:
        _check_pair("at", self.at)


def _check_pair(name: str, value: Sequence[float]) -> None:
    if len(value) != 2:
        raise UserError(f"{name} has {len(value)} numbers: it needs x and y")


class Drawing:
    """The bodies of a rig by name, each after the one that carries it. A joint that the rig's file does not draw gets a
    dial, or a sled where it moves along a line.
    """

    def __init__(self, rig: Rig) -> None:
        """Raises UserError where the section ``drawing`` of the rig's file names what is not there."""
        self.rig, self.bodies = rig, dict[str, DrawnBody]()
        where = f"{rig.file}: drawing"
        moving = {name: joint for name, joint in rig.joints.joints.items() if _moves(joint)}
        content = section(rig.content, "drawing", str(rig.file))
        for name, value in content.items():
            body = built(DrawnBody, value, f"{where}.{name}")
            if name in (BASE, GROUND):
                raise UserError(f"{where}.{name}: is what all bodies stand on; give it another name")
            if body.on and body.on not in self.bodies:
                raise UserError(f"{where}.{name}.on: no body {body.on} before it")
            if body.joint and body.joint not in moving:
                known = ", ".join(moving) or "none"
                raise UserError(f"{where}.{name}.joint: {body.joint!r} is no joint that moves; known are {known}")
            if body.joint and body.joint in self.drawn:
                raise UserError(f"{where}.{name}.joint: {body.joint} moves another body already")
            self.bodies[name] = body
        left = [name for name in moving if name not in self.drawn]
        x = max((x for x, _ in self._corners()), default=-APART) + APART
        for index, name in enumerate(left):
            self.bodies[f"{name}_dial"] = self._dial(name, moving[name], x + index * APART)

    @property
    def drawn(self) -> set[str]:
        """The joints that move a body."""
        return {body.joint for body in self.bodies.values() if body.joint}

    @property
    def joints(self) -> list[str]:
        """The same, in the rig's order."""
        return [name for name in self.rig.joints.names if name in self.drawn]

    def _dial(self, name: str, joint: Joint, x: float) -> DrawnBody:
        unit = next((item.unit for item in self.rig.system.states if item.name in (joint.position, joint.velocity)), "")
        if unit in ("m", "m/s"):
            return DrawnBody(joint=name, slides=True, at=(x, 0.0), shapes=(Shape(box=(DIAL, DIAL)),))
        return DrawnBody(joint=name, at=(x, 0.0), shapes=(Shape(disc=DIAL),))

    def reach(self, body: DrawnBody) -> tuple[float, float]:
        """Lowest and highest position of the joint that moves a body; infinite without stops."""
        names, position = [item.name for item in self.rig.system.states], self.rig.joints.joints[body.joint].position
        if position not in names:
            return -math.inf, math.inf
        low, high = self.rig.travel[:, names.index(position)].tolist()
        return low, high

    def extent(self) -> tuple[float, float, float, float]:
        """Lowest x and y and highest x and y of all that the bodies reach, those that carry others at rest [m]."""
        corners = list(self._corners()) or [(0.0, 0.0)]
        xs, ys = [x for x, _ in corners], [y for _, y in corners]
        return min(xs), min(ys), max(xs), max(ys)

    def _corners(self) -> Iterator[tuple[float, float]]:
        origins = {"": (0.0, 0.0)}
        for name, body in self.bodies.items():
            x, y = origins[name] = tuple(a + b for a, b in zip(origins[body.on], body.at, strict=True))  # type: ignore[assignment]
            low, high = self.reach(body) if body.joint else (0.0, 0.0)
            ends = [low, 0.0, high] if math.isfinite(high - low) else [k * math.pi / 8 for k in range(16)]
            for shape in body.shapes:
                (width, height), (left, up) = shape.half, shape.at
                points = [(left + a * width, up + b * height) for a in (-1, 1) for b in (-1, 1)]
                for end in ends:
                    if body.slides:
                        yield from ((x + a + (end if math.isfinite(high - low) else 0.0), y + b) for a, b in points)
                    else:
                        cos, sin = math.cos(end), math.sin(end)
                        yield from ((x + a * cos - b * sin, y + a * sin + b * cos) for a, b in points)

    def description(self) -> list[dict[str, Any]]:
        """The bodies as plain data, as the page takes them."""
        return [
            {
                "name": name,
                "joint": body.joint,
                "slides": body.slides,
                "on": body.on,
                "at": list(body.at),
                "shapes": [{"box": list(shape.box), "disc": shape.disc, "at": list(shape.at)} for shape in body.shapes],
            }
            for name, body in self.bodies.items()
        ]

    def urdf(self) -> str:
        """The bodies as URDF (http://wiki.ros.org/urdf/XML), the plane of the drawing upright: z of ROS is its y. Its
        joints have the names that joint_states has.
        """
        robot = ElementTree.Element("robot", name=self.rig.name)
        ElementTree.SubElement(robot, "link", name=BASE)
        ElementTree.SubElement(robot, "link", name=GROUND)
        upright = _joint(robot, "upright", "fixed", parent=BASE, child=GROUND, at=(0.0, 0.0))
        upright.find("origin").set("rpy", f"{math.pi / 2:.9g} 0 0")  # type: ignore[union-attr]
        for name, body in self.bodies.items():
            link = ElementTree.SubElement(robot, "link", name=name)
            for shape in body.shapes:
                visual = ElementTree.SubElement(link, "visual")
                ElementTree.SubElement(visual, "origin", xyz=_text(*shape.at, 0.0), rpy="0 0 0")
                geometry = ElementTree.SubElement(visual, "geometry")
                if shape.box:
                    ElementTree.SubElement(geometry, "box", size=_text(*shape.box, DEPTH))
                else:
                    ElementTree.SubElement(geometry, "cylinder", radius=_text(shape.disc), length=_text(DEPTH))
                material = ElementTree.SubElement(visual, "material", name="moving" if body.joint else "standing")
                ElementTree.SubElement(material, "color", rgba=COLOUR if body.joint else GREY)
            self._join(robot, name, body)
        ElementTree.indent(robot)
        return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"

    def _join(self, robot: ElementTree.Element, name: str, body: DrawnBody) -> None:
        """The joint between a body and what carries it."""
        parent = body.on or GROUND
        if not body.joint:
            _joint(robot, f"{name}_stands", "fixed", parent=parent, child=name, at=body.at)
            return
        low, high = self.reach(body)
        free = not math.isfinite(high - low)
        kind = "prismatic" if body.slides else "continuous" if free else "revolute"
        joint = _joint(robot, body.joint, kind, parent=parent, child=name, at=body.at)
        ElementTree.SubElement(joint, "axis", xyz="1 0 0" if body.slides else "0 0 1")
        inputs = [item.name for item in self.rig.system.inputs]
        effort = self.rig.joints.joints[body.joint].effort
        largest = BEYOND
        if effort:
            actuator = self.rig.actuators[inputs.index(effort)]
            largest = max(-actuator.low, actuator.high)
        limits = {"effort": _text(largest), "velocity": _text(BEYOND)}  # which no rig's file says
        if kind != "continuous":
            limits |= {"lower": _text(max(low, -BEYOND)), "upper": _text(min(high, BEYOND))}
        ElementTree.SubElement(joint, "limit", limits)


def _moves(joint: Joint) -> bool:
    return bool(joint.position or joint.velocity)


def urdf_of(rig: Rig) -> str:
    """The URDF of a rig, "" where no joint of it moves."""
    drawing = Drawing(rig)
    return drawing.urdf() if drawing.joints else ""


def _joint(
    robot: ElementTree.Element, name: str, kind: str, *, parent: str, child: str, at: Sequence[float]
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_text(*at, 0.0), rpy="0 0 0")
    return joint


def _text(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
