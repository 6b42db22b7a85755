"""The launch file against what `hybrid-sysid run` starts, and against the parameters that nodes declare."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("launch_ros", reason="needs ROS's launch, which no wheel brings")

import rclpy
from rclpy.context import Context

from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserError, UserErrors

RIG = load("cam_beam")
perform_substitutions = pytest.importorskip("launch.utilities").perform_substitutions
TextSubstitution = pytest.importorskip("launch.substitutions").TextSubstitution
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
    """But that it goes on at the end of the reference."""
    launched = launch_file.parameters(given(launch_file, **more))
    asked: dict[str, Any] = {name: value == "true" if name != "bag" else value for name, value in more.items()}
    same(launched, Run(parameters={"reference": {"stay": True}}, **asked).values)
    launched = launch_file.parameters(given(launch_file, duration="3", priority="20", **more))
    same(launched, Run(duration=3.0, priority=20, **asked).values)


def same(launched: Any, run: Any) -> None:
    """The nodes have the same parameters, whichever are left to their defaults."""
    assert launched.keys() == run.keys()
    for node in launched.keys() - {"recorder"}:
        defaults = configuration.defaults("cam_beam", node)
        wanted, found = ({**defaults, **values[node]} for values in (run, launched))
        assert found == wanted, node
    assert launched.get("recorder", {}).get("further") == run.get("recorder", {}).get("further")


def test_the_nodes_know_what_they_are_given(launch_file: Any) -> None:
    for node, values in launch_file.parameters(given(launch_file, bag="bag", lockstep="true")).items():
        known = configuration.parameters(RIG, node)
        assert all(known[name].checked(value) == value for name, value in values.items())


def test_each_node_is_started_once(launch_file: Any) -> None:
    loop = ["controller", "estimator", "plant", "reference"]
    assert sorted(executables(launch_file)) == loop
    assert executables(launch_file, composed="true") == ["composed"]
    real = executables(launch_file, simulated="false", bag="bag")
    assert sorted(real) == ["controller", "estimator", "recorder", "reference"]


def test_nodes_of_one_process_get_their_parameters_in_any_namespace(launch_file: Any) -> None:
    """A real rig's controller is at rest until somebody arms it."""
    launching = LaunchContext()
    launching.launch_configurations.update(given(launch_file, composed="true", simulated="false", namespace="left"))
    found = next(item for item in launch_file.nodes(launching) if getattr(item, "node_executable", "") == "composed")
    found._perform_substitutions(launching)
    texts = [perform_substitutions(launching, word) for word in found.cmd[1:] if isinstance(word[0], TextSubstitution)]
    files = [word for text in texts if text.endswith(".yaml") for word in ("--params-file", text)]
    context = Context()
    rclpy.init(args=["--ros-args", *files], context=context)
    try:
        node = rclpy.create_node(
            "controller", namespace="left", context=context, automatically_declare_parameters_from_overrides=True
        )
        assert node.get_parameter("armed").value is False
        node.destroy_node()
    finally:
        context.try_shutdown()


def test_what_is_wrong_is_reported_before_anything_is_started(launch_file: Any, tmp_path: Path, caplog: Any) -> None:
    """All of it, also what a parameter file says for a node, whatever else is in that."""
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n  ros__parameters: {use_sim_time: false, kind: sine}\n"
        "/left/controller:\n  ros__parameters: {horizon: 2000}\n"
        "/right/controller:\n  ros__parameters: {period: -1.0}\n"
    )
    asked = given(launch_file, params_file=str(file), namespace="left", rate="300")
    with pytest.raises(UserErrors) as problems:
        launch_file.check(asked, launch_file.parameters(asked))
    assert [line.split(":")[0] for line in problems.value.lines] == ["controller", "plant"]
    with pytest.raises(UserError, match="argument rate"):
        launch_file.parameters(given(launch_file, rate="fast"))


@dataclass
class End:
    """The end of a process, as launch tells of it."""

    returncode: int
    process_name: str = "plant-1"


def test_a_node_that_dies_is_started_again_so_often_and_then_all_end(launch_file: Any) -> None:
    context, watch, made = LaunchContext(), launch_file.Watch(2), []

    def make(resting: bool) -> Any:
        made.append(resting)
        return launch_file.Node(executable="plant")

    def ended(*end: Any) -> bool:
        return any(isinstance(item, launch_file.EmitEvent) for item in watch.ended(make, True, End(*end), context))

    assert [ended(-9, f"plant-{k}") for k in range(3)] == [False, False, True]
    assert made == [False, False]
    assert ended(0, "reference-2")
    assert ended(2, "controller-3")


@pytest.mark.parametrize(
    ("said", "rests"), [(b"ready\nat rest: stopped\n", True), (b"at rest\nmay move: armed\n", False)]
)
def test_a_controller_that_died_at_rest_comes_back_at_rest(launch_file: Any, said: bytes, rests: bool) -> None:
    watch, made = launch_file.Watch(2), []

    def make(resting: bool) -> Any:
        made.append(resting)
        return launch_file.Node(executable="controller")

    watch.started(make, moves=True)
    watch.heard(SimpleNamespace(text=said))
    watch.ended(make, True, End(-9, "controller-1"), LaunchContext())
    assert made == [False, rests]


def test_a_rig_with_joints_has_a_description(launch_file: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch_file, "get_package_prefix", lambda package: "/")
    assert len(launch_file.described(given(launch_file))) == 1
    assert not launch_file.described(given(launch_file, robot_state_publisher="false"))


def test_every_argument_is_described(launch_file: Any) -> None:
    assert all(description.endswith(".") for _, _, description in launch_file.ARGUMENTS.values())


def test_what_is_no_choice_is_refused(launch_file: Any) -> None:
    arguments = {item.name: item for item in launch_file.generate_launch_description().get_launch_arguments()}
    assert arguments.keys() == launch_file.ARGUMENTS.keys()
    context = LaunchContext()
    context.launch_configurations["simulated"] = "perhaps"
    with pytest.raises(RuntimeError, match="simulated"):
        arguments["simulated"].execute(context)
