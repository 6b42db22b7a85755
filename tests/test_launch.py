"""The launch file against what `hybrid-sysid run` starts, and against the parameters that nodes declare."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("launch_ros", reason="needs ROS's launch, which no wheel brings")
pytest.importorskip("PIL", reason="needs the extra video")

from hybrid_sysid_ros.extensions.commander.companion import Commander
from hybrid_sysid_ros.extensions.vision.companion import Vision
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserError

RIG = load("cam_beam")
LaunchContext = pytest.importorskip("launch").LaunchContext  # the folder of that name is no package
FILE = Path(__file__).parents[1] / "launch" / "rig.launch.py"


@pytest.fixture(scope="module")
def launch_file() -> Any:
    spec = spec_from_file_location("rig_launch", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _given(launch_file: Any, **asked: str) -> dict[str, str]:
    assert asked.keys() <= launch_file.ARGUMENTS.keys()
    return {name: default for name, (default, *_) in launch_file.ARGUMENTS.items()} | asked


def _executables(launch_file: Any, **asked: str) -> list[str]:
    context = LaunchContext()
    context.launch_configurations.update(_given(launch_file, **asked))
    found = launch_file.nodes(context)
    return [item.node_executable for item in found if hasattr(item, "node_executable")]


@pytest.mark.parametrize("more", [{}, {"lockstep": "true"}, {"commander": "true"}, {"bag": "bag"}])
def test_a_camera_by_the_launch_file_is_that_of_a_run(launch_file: Any, more: dict[str, str]) -> None:
    launched = launch_file.parameters(_given(launch_file, camera="true", **more))
    asked: dict[str, Any] = {name: value == "true" if name != "bag" else value for name, value in more.items()}
    joined = [Vision()] + ([Commander()] if asked.pop("commander", False) else [])
    run = Run(companions=joined, priority=0, **asked).values
    assert launched.keys() == run.keys()
    for node in ("plant", "estimator", "camera", "vision"):
        defaults = configuration.defaults("cam_beam", node)
        wanted, found = ({**defaults, **values[node], "priority": 0} for values in (run, launched))
        assert found == wanted, node
    assert launched.get("recorder", {}).get("further") == run.get("recorder", {}).get("further")


def test_the_nodes_know_what_they_are_told(launch_file: Any) -> None:
    for node, values in launch_file.parameters(_given(launch_file, camera="true", view="true", layers="mine")).items():
        known = configuration.parameters(RIG, node)
        assert all(known[name].checked(value) == value for name, value in values.items())


def test_each_node_is_started_once(launch_file: Any) -> None:
    loop = ["controller", "estimator", "plant", "reference"]
    assert sorted(_executables(launch_file)) == loop
    assert sorted(_executables(launch_file, camera="true")) == sorted([*loop, "camera", "vision"])
    assert sorted(_executables(launch_file, camera="true", composed="true")) == ["camera", "composed", "vision"]
    real = _executables(launch_file, camera="true", simulated="false", bag="bag")
    assert sorted(real) == ["controller", "estimator", "recorder", "reference", "vision"]


def test_a_rig_without_a_picture_of_its_output_is_refused(launch_file: Any) -> None:
    with pytest.raises(UserError, match="a camera sees the position of"):
        launch_file.parameters(_given(launch_file, camera="true", rig="wheel_motor"))


def test_what_is_no_choice_is_refused(launch_file: Any) -> None:
    arguments = {item.name: item for item in launch_file.generate_launch_description().get_launch_arguments()}
    assert arguments.keys() == launch_file.ARGUMENTS.keys()
    context = LaunchContext()
    context.launch_configurations["camera"] = "perhaps"
    with pytest.raises(RuntimeError, match="camera"):
        arguments["camera"].execute(context)
