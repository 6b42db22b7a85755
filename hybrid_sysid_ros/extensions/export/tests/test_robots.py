"""hybrid-sysid export urdf and mjcf: joints as identified, in MuJoCo too, and what they can't say by its name."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.extensions.export.robots import export
from hybrid_sysid_ros.extensions.export.robots.joint_dynamics import joints_of
from hybrid_sysid_ros.rigs import folder
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError


def loaded(name):
    return load_rig(name), hs.load_model(shipped(name, "model"))


@pytest.fixture(scope="module")
def sled():
    """The template's sled with 1.5 kg, 4 N s/m and 0.8 N, which MJCF can say whole."""
    rig = load_rig(folder.HOME / "_template")
    _, model = loaded("wheel_motor")
    span = {"position": (-0.2, 0.2), "velocity": (-1.0, 1.0), "force": (-5.0, 5.0)}
    return rig, replace(model, rig="sled", structure="gray", system=rig.system, training_range=span)


def test_a_sled_s_numbers_are_those_of_its_parameters(sled):
    (joint,) = joints_of(*sled)
    system = sled[0].system
    assert (joint.inertia, joint.damping, joint.friction) == pytest.approx(
        (system.mass, system.damping, system.friction), rel=1e-6
    )
    assert (joint.gain, joint.spring, joint.offset) == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert (joint.slides, joint.identified, len(joint.left_out)) == (True, True, 1)
    assert "acts after" in joint.left_out[0]


def test_a_sled_in_mujoco_runs_as_ours_within_one_percent(sled, tmp_path):
    pytest.importorskip("mujoco", reason="needs the extra [mujoco]")
    rig, model = sled
    done = export.export_robot(rig, model, tmp_path / "sled.xml", form="mjcf", seal="s")
    assert done.difference is not None
    assert done.difference < 0.01


def test_the_beam_s_urdf_has_its_friction_and_says_what_is_left_out(tmp_path):
    rig, model = loaded("cam_beam")
    done = export.export_robot(rig, model, tmp_path / "beam.urdf", form="urdf", seal="s")
    text = (tmp_path / "beam.urdf").read_text()
    dynamics = ElementTree.fromstring(text).find("joint[@name='beam']/dynamics")
    assert dynamics is not None
    assert float(dynamics.attrib["damping"]) == pytest.approx(done.joints[0].damping, rel=1e-6)
    assert 1.0 < float(dynamics.attrib["friction"]) < 10.0
    said = ("inertia of joint beam is not identified", "acts after", "not linear", "spring of joint", "drive of joint")
    for words in said:
        assert words in text


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("flexible_joint", r"joint (motor|link) depends on"),
        ("drill_string", "is no position or velocity of a joint"),
        ("winged_cone", "speed, path_angle, height"),
        ("balancing_robot", "write an FMU"),
    ],
)
def test_what_joints_can_t_say_is_refused_by_its_name(tmp_path, name, why):
    rig, model = loaded(name)
    with pytest.raises(UserError, match=why):
        export.export_robot(rig, model, tmp_path / "robot.xml", form="mjcf", seal="s")
    assert not (tmp_path / "robot.xml").exists()


def test_numbers_that_are_not_finite_never_reach_a_file(sled):
    for joint in joints_of(*sled):
        assert np.isfinite([joint.inertia, joint.friction, joint.damping, joint.spring, joint.gain]).all()
