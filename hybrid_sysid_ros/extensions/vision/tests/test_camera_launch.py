"""The camera by the launch file, against what `hybrid-sysid run` starts."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("launch_ros", reason="needs ROS's launch, which no wheel brings")
pytest.importorskip("PIL", reason="needs the extra video")

from hybrid_sysid_ros.extensions.vision.companion import Vision
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserError
from tests.test_launch import RIG, executables, given, launch_file, same

__all__ = ["launch_file"]  # a fixture


@pytest.mark.parametrize("more", [{}, {"lockstep": "true"}, {"bag": "bag"}])
def test_a_camera_by_the_launch_file_is_that_of_a_run(launch_file: Any, more: dict[str, str]) -> None:
    launched = launch_file.parameters(given(launch_file, camera="true", **more))
    asked: dict[str, Any] = {name: value == "true" if name != "bag" else value for name, value in more.items()}
    same(launched, Run(companions=[Vision()], priority=0, **asked).values)


def test_the_nodes_know_what_they_are_given(launch_file: Any) -> None:
    for node, values in launch_file.parameters(given(launch_file, camera="true", layers="mine")).items():
        known = configuration.parameters(RIG, node)
        assert all(known[name].checked(value) == value for name, value in values.items())


def test_each_node_is_started_once(launch_file: Any) -> None:
    loop = ["controller", "estimator", "plant", "reference"]
    assert sorted(executables(launch_file, camera="true")) == sorted([*loop, "camera", "vision"])
    assert sorted(executables(launch_file, camera="true", composed="true")) == ["camera", "composed", "vision"]
    real = executables(launch_file, camera="true", simulated="false", bag="bag")
    assert sorted(real) == ["controller", "estimator", "recorder", "reference", "vision"]


def test_a_rig_without_a_picture_of_its_output_is_refused(launch_file: Any) -> None:
    with pytest.raises(UserError, match="a camera sees the position of"):
        launch_file.parameters(given(launch_file, camera="true", rig="wheel_motor"))
