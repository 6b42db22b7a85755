"""Drawings and URDF: what moves is where trigonometry says, and another parser reads the same."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.view.drawing import Drawing
from hybrid_sysid_ros.rigs.folder import names
from hybrid_sysid_ros.rigs.joints import Joint, Joints
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError
from tests.rigs.toys import Lags, rig_of

NAMES = tuple(names())


def of(**drawing: Any) -> Drawing:
    return Drawing(replace(load("flexible_joint"), content={**load("flexible_joint").content, "drawing": drawing}))


@pytest.mark.parametrize("name", NAMES)
def test_the_urdf_of_every_rig_has_its_joints(name: str) -> None:
    parser = pytest.importorskip("urdf_parser_py.urdf", reason="needs urdf-parser-py: install hybrid_sysid_ros[dev]")
    rig = load(name)
    robot = parser.URDF.from_xml_string(Drawing(rig).urdf().partition("\n")[2])
    moving = [joint for joint in robot.joints if joint.type != "fixed"]
    assert {joint.name for joint in moving} == {
        name for name, joint in rig.joints.joints.items() if joint.position or joint.velocity
    }
    assert {joint.child for joint in robot.joints} == {link.name for link in robot.links} - {robot.get_root()}
    assert robot.get_root() == "base"


def test_limits_are_the_travel_and_the_actuators() -> None:
    joint = ElementTree.fromstring(Drawing(load("cam_beam")).urdf()).find("joint[@name='beam']")
    assert joint is not None
    limit = joint.find("limit")
    assert limit is not None
    assert joint.get("type") == "revolute"
    assert float(limit.get("upper", "")) == pytest.approx(math.radians(13.0))  # 10 V of 1.3 degrees
    assert float(limit.get("lower", "")) == pytest.approx(-math.radians(13.0))
    assert float(limit.get("effort", "")) == 10.0


def test_a_chain_of_bodies_is_where_trigonometry_says() -> None:
    """Two rods of 1 m, one on the end of the other: its tip by the URDF's transforms and by hand."""
    rod = {"shapes": [{"box": [1.0, 0.1], "at": [0.5, 0.0]}]}
    drawing = of(upper={**rod, "joint": "motor"}, lower={**rod, "joint": "link", "on": "upper", "at": [1.0, 0.0]})
    joints = {joint.find("child").get("link"): joint for joint in ElementTree.fromstring(drawing.urdf()).iter("joint")}  # type: ignore[union-attr]
    angles, point, link = {"motor": 0.3, "link": -1.1}, np.array([1.0, 0.0, 0.0, 1.0]), "lower"
    while link != "base":
        joint = joints[link]
        axis = joint.find("axis")
        if axis is not None:
            assert axis.get("xyz") == "0 0 1"
            cos, sin = math.cos(angles[str(joint.get("name"))]), math.sin(angles[str(joint.get("name"))])
            point = np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]) @ point
        origin = joint.find("origin")
        assert origin is not None
        roll = float(str(origin.get("rpy")).split()[0])
        cos, sin = math.cos(roll), math.sin(roll)
        point = np.array([[1, 0, 0, 0], [0, cos, -sin, 0], [0, sin, cos, 0], [0, 0, 0, 1]]) @ point
        point[:3] += [float(value) for value in str(origin.get("xyz")).split()]
        parent = joint.find("parent")
        assert parent is not None
        link = str(parent.get("link"))
    x, z = math.cos(0.3) + math.cos(-0.8), math.sin(0.3) + math.sin(-0.8)
    np.testing.assert_allclose(point[:3], [x, 0.0, z], atol=1e-8)  # y of the drawing is up


def test_what_is_seen_holds_all_that_moves() -> None:
    left, low, right, high = of(arm={"joint": "link", "shapes": [{"box": [2.0, 0.0001], "at": [1.0, 0.0]}]}).extent()
    assert (left, low, high) == pytest.approx((-2.0, -2.0, 2.0), abs=1e-3)
    assert right >= 2.0


def test_a_joint_that_nobody_draws_gets_a_dial_or_a_sled() -> None:
    joints = Joints.of({"x": {"position": "first"}, "y": {"position": "second"}}, Lags(), "joints")
    drawing = Drawing(rig_of(Lags(), joints=joints))
    kinds = {body.joint: body.slides for body in drawing.bodies.values()}
    assert kinds == {"x": True, "y": False, "product": False}
    assert Joint(position="first") == joints.joints["x"]


@pytest.mark.parametrize(
    ("drawing", "words"),
    [
        ({"arm": {"shapes": [], "joint": "elbow"}}, "drawing.arm.joint: 'elbow' is no joint that moves"),
        ({"arm": {"shapes": [], "on": "leg"}}, "drawing.arm.on: no body leg before it"),
        ({"arm": {"joint": "link"}}, "drawing.arm: shapes is missing"),
        ({"arm": {"shapes": [{"box": [1.0]}]}}, r"drawing.arm.shapes\[0\]: box has 1 numbers"),
        ({"arm": {"shapes": [{"at": [0.0, 0.0]}]}}, "a shape is a box"),
        ({"arm": {"shapes": [{"disc": -1.0}]}}, "a shape is a box"),
        ({"arm": {"shapes": {"disc": 1.0}}}, "needs a list"),
        ({"base": {"shapes": []}}, "another name"),
        (
            {"one": {"shapes": [], "joint": "link"}, "two": {"shapes": [], "joint": "link"}},
            "moves another body already",
        ),
    ],
)
def test_what_is_wrong_is_reported_by_file_and_key(drawing: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        of(**drawing)
