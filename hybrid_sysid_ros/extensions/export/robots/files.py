"""The texts of URDF and MJCF files with a model's joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from hybrid_sysid_ros.extensions.export.robots.joint_dynamics import JointDynamics
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support import extensions

TIMESTEP = 0.001
"""Of MuJoCo [s]."""
HARD = "0.9999 0.9999 0.0001 0.5 2"
"""Impedance of MuJoCo's dry friction: nearly that of a joint that sticks."""
DEPTH = 0.03
"""Of the bodies, across the plane of the drawing [m]."""
SHARE = 0.05
"""Of a joint's inertia that its body has, the rest is armature: MuJoCo scales the softness of dry friction by the
body's inertia alone, and without any a joint would slide as if it were greased.
"""
ROUNDING = 1e-6
"""Of a fit's numbers."""
LIGHT = 1e-6
"""Mass [kg] and inertia [kg m^2] of bodies that stand still."""


def remarks(rig: Rig, model: Model, joints: Sequence[JointDynamics], seal: str) -> list[str]:
    """What a file says of itself: where its numbers come from, and what is not in it."""
    found = [f"{model.structure} of {rig.name}, {seal}: friction and inertia as identified."]
    found += [line for joint in joints for line in joint.left_out]
    return [line.replace("--", "- ") for line in found]


def unsaid_in_urdf(joint: JointDynamics) -> list[str]:
    """What of a joint URDF has no place for."""
    found = []
    if abs(joint.spring) > ROUNDING:
        found.append(
            f"The spring of joint {joint.name} towards zero ({joint.spring:.3g} per unit) has no place in URDF."
        )
    if joint.input and (not joint.identified or abs(joint.offset) > ROUNDING):
        found.append(
            f"The drive of joint {joint.name} has no place in URDF: {joint.gain:.3g} per unit of {joint.input}, "
            f"{joint.offset:+.3g} where that is 0."
        )
    return found


def urdf(rig: Rig, joints: Sequence[JointDynamics], notes: Sequence[str]) -> str:
    """The rig's URDF with damping, friction and inertia. Raises UserError without an extension that draws rigs."""
    text: str = extensions.one("descriptions", "urdf", "export urdf needs the extension view")(rig)
    robot = ElementTree.fromstring(text)
    for line in reversed(notes):
        robot.insert(0, ElementTree.Comment(f" {line} "))
    for joint in joints:
        found = robot.find(f"joint[@name='{joint.name}']")
        if found is None:
            continue
        numbers = {"damping": _text(joint.damping), "friction": _text(joint.friction)}
        ElementTree.SubElement(found, "dynamics", numbers)
        limit, span = found.find("limit"), _span(rig, joint)
        if limit is not None:
            limit.set("effort", _text(max(abs(joint.gain * value + joint.offset) for value in span)))
        link = robot.find(f"link[@name='{found.find('child').get('link')}']")  # type: ignore[union-attr]
        assert link is not None
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value=_text(joint.inertia if joint.slides else 1.0))
        around = _text(1.0 if joint.slides else joint.inertia)
        ElementTree.SubElement(inertial, "inertia", ixx=around, iyy=around, izz=around, ixy="0", ixz="0", iyz="0")
    return _written(robot)


def mjcf(rig: Rig, joints: Sequence[JointDynamics], notes: Sequence[str]) -> str:
    """A MuJoCo model: bodies as they are drawn, joints with armature, damping, frictionloss and spring, and drives."""
    root = ElementTree.Element("mujoco", model=rig.name)
    for line in notes:
        root.append(ElementTree.Comment(f" {line} "))
    ElementTree.SubElement(root, "compiler", angle="radian")
    ElementTree.SubElement(root, "option", timestep=_text(TIMESTEP), gravity="0 0 0", integrator="implicitfast")
    world = ElementTree.SubElement(root, "worldbody")
    found, by_name = {"": world}, {joint.name: joint for joint in joints}
    for body in _bodies(rig, joints):
        parent = found.get(body["on"], world)
        element = found[body["name"]] = ElementTree.SubElement(
            parent, "body", name=body["name"], pos=_text(*body["at"], 0.0)
        )
        joint = by_name.get(body["joint"])
        inertia = SHARE * joint.inertia if joint is not None else LIGHT
        around = _text(inertia, inertia, inertia)
        ElementTree.SubElement(element, "inertial", pos="0 0 0", mass=_text(inertia), diaginertia=around)
        if joint is not None:
            _mjcf_joint(element, rig, joint)
        for shape in body["shapes"]:
            given = {"type": "cylinder", "size": _text(shape["disc"], 0.5 * DEPTH)}
            if shape["box"]:
                given = {"type": "box", "size": _text(*(0.5 * value for value in shape["box"]), 0.5 * DEPTH)}
            given |= {"pos": _text(*shape["at"], 0.0), "contype": "0", "conaffinity": "0"}
            given |= {"rgba": "0.16 0.44 0.75 1" if body["joint"] else "0.55 0.57 0.60 1"}
            ElementTree.SubElement(element, "geom", given)
    actuators = ElementTree.SubElement(root, "actuator")
    for joint in joints:
        if joint.input:
            low, high = _span(rig, joint)
            ElementTree.SubElement(
                actuators, "general", name=joint.input, joint=joint.name, ctrllimited="true",
                ctrlrange=_text(low, high), gainprm=_text(joint.gain), biastype="affine",
                biasprm=_text(joint.offset, -joint.spring, 0.0),
            )  # fmt: skip
    return _written(root)


def _mjcf_joint(body: ElementTree.Element, rig: Rig, joint: JointDynamics) -> None:
    given = {"name": joint.name, "type": "slide" if joint.slides else "hinge"}
    given |= {"axis": "1 0 0" if joint.slides else "0 0 1", "armature": _text((1.0 - SHARE) * joint.inertia)}
    given |= {"damping": _text(max(joint.damping, 0.0)), "frictionloss": _text(joint.friction), "solimpfriction": HARD}
    names = [item.name for item in rig.system.states]
    low, high = rig.travel[:, names.index(joint.position)] if joint.position in names else (-math.inf, math.inf)
    if math.isfinite(high - low):
        given |= {"limited": "true", "range": _text(float(low), float(high))}
    ElementTree.SubElement(body, "joint", given)


def _bodies(rig: Rig, joints: Sequence[JointDynamics]) -> list[Mapping[str, Any]]:
    """Bodies as the rig's file draws them, or one for each joint without an extension that draws rigs."""
    if "drawing" in extensions.targets("sections"):
        drawn: list[Mapping[str, Any]] = extensions.one("sections", "drawing")(rig).description()
        return drawn
    shape = {"box": [0.1, 0.1], "disc": 0.0, "at": [0.0, 0.0]}
    return [
        {"name": f"{item.name}_body", "joint": item.name, "on": "", "at": [0.3 * k, 0.0], "shapes": [shape]}
        for k, item in enumerate(joints)
    ]


def _span(rig: Rig, joint: JointDynamics) -> tuple[float, float]:
    """Lowest and highest input of a joint."""
    names = [item.name for item in rig.system.inputs]
    if joint.input not in names:
        return 0.0, 0.0
    actuator = rig.actuators[names.index(joint.input)]
    return actuator.low, actuator.high


def _written(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _text(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
