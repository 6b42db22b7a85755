"""The launch file against what `hybrid-sysid run` starts, and against the parameters that nodes declare."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("launch_ros", reason="needs ROS's launch, which no wheel brings")

from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.run import Run

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


def given(launch_file: Any, **asked: str) -> dict[str, str]:
    assert asked.keys() <= launch_file.ARGUMENTS.keys()
    return {name: default for name, (default, *_) in launch_file.ARGUMENTS.items()} | asked


def executables(launch_file: Any, **asked: str) -> list[str]:
    context = LaunchContext()
    context.launch_configurations.update(given(launch_file, **asked))
    found = launch_file.nodes(context)
    return [item.node_executable for item in found if hasattr(item, "node_executable")]


@pytest.mark.parametrize("more", [{}, {"lockstep": "true"}, {"bag": "bag"}])
def test_a_loop_by_the_launch_file_is_that_of_a_run(launch_file: Any, more: dict[str, str]) -> None:
    launched = launch_file.parameters(given(launch_file, **more))
    asked: dict[str, Any] = {name: value == "true" if name != "bag" else value for name, value in more.items()}
    same(launched, Run(priority=0, **asked).values)


def same(launched: Any, run: Any) -> None:
    """The nodes have the same parameters, whichever are left to their defaults."""
    assert launched.keys() == run.keys()
    for node in launched.keys() - {"recorder"}:
        defaults = configuration.defaults("cam_beam", node)
        wanted, found = ({**defaults, **values[node], "priority": 0} for values in (run, launched))
        assert found == wanted, node
    assert launched.get("recorder", {}).get("further") == run.get("recorder", {}).get("further")


def test_the_nodes_know_what_they_are_told(launch_file: Any) -> None:
    for node, values in launch_file.parameters(given(launch_file, bag="bag", lockstep="true")).items():
        known = configuration.parameters(RIG, node)
        assert all(known[name].checked(value) == value for name, value in values.items())


def test_each_node_is_started_once(launch_file: Any) -> None:
    loop = ["controller", "estimator", "plant", "reference"]
    assert sorted(executables(launch_file)) == loop
    assert executables(launch_file, composed="true") == ["composed"]
    real = executables(launch_file, simulated="false", bag="bag")
    assert sorted(real) == ["controller", "estimator", "recorder", "reference"]


def test_what_is_no_choice_is_refused(launch_file: Any) -> None:
    arguments = {item.name: item for item in launch_file.generate_launch_description().get_launch_arguments()}
    assert arguments.keys() == launch_file.ARGUMENTS.keys()
    context = LaunchContext()
    context.launch_configurations["simulated"] = "perhaps"
    with pytest.raises(RuntimeError, match="simulated"):
        arguments["simulated"].execute(context)
