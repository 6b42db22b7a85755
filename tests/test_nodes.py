"""What the nodes share: their loop in lockstep, parameters, topics and timing."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.nodes.timing import Histogram
from tests.node_bench import Bench, ask, joint, stamp_of

# The loop


def start_loop(bench: Bench, model: Path, policy: Path) -> None:
    bench.start(ReferenceNode, lockstep=True)
    bench.start(EstimatorNode, model=str(model), lockstep=True, latency=0.0)
    network = {"policy": "network", "policy_path": str(policy), "certificate": "ignore"}
    bench.start(ControllerNode, model=str(model), lockstep=True, latency=0.0, **network)
    bench.start(PlantNode, lockstep=True, wait_for_readers=3, seed=5)


def closed_loop(domain: int, model: Path, policy: Path, steps: int) -> tuple[list[JointState], list[float]]:
    bench = Bench(domain)
    try:
        measurements, commands = bench.listen("joint_states"), bench.listen("joint_command")
        start_loop(bench, model, policy)
        bench.until(lambda: len(measurements) >= steps and len(commands) >= steps)
        return measurements[:steps], [command.effort[0] for command in commands[:steps]]
    finally:
        bench.close()


def test_a_loop_in_lockstep_repeats_to_the_last_bit(domain: int, model_folder: Path, policy_folder: Path) -> None:
    measurements, commands = closed_loop(domain, model_folder, policy_folder, 300)
    stamps = np.array([stamp_of(message) for message in measurements])
    assert (np.diff(stamps) == SECOND // 200).all()
    assert np.std(commands) > 0.1
    again, commands_again = closed_loop(domain, model_folder, policy_folder, 300)
    assert commands == commands_again
    assert [message.position[0] for message in measurements] == [message.position[0] for message in again]


@pytest.mark.parametrize("names", [["plant"], ["plant", "controller", "estimator"]])
def test_a_loop_in_lockstep_goes_on_after_reset(
    bench: Bench, model_folder: Path, policy_folder: Path, names: list[str]
) -> None:
    measurements, commands = bench.listen("joint_states"), bench.listen("joint_command")
    start_loop(bench, model_folder, policy_folder)
    bench.until(lambda: len(commands) >= 600)  # 3 s of the loop, more than a stamp may be late
    for name in names:
        assert ask(bench, Trigger, f"{name}/reset", Trigger.Request()).success
    before = len(measurements)
    bench.until(lambda: stamp_of(measurements[-1]) < 2 * SECOND and len(measurements) >= before + 100)


def test_a_stop_by_hand_lasts_in_lockstep_too(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    """It has no stamp and no name, as what ros2 topic pub sends."""
    commands, hand = bench.listen("joint_command"), bench.speak("joint_command")
    bench.listen("joint_states")
    start_loop(bench, model_folder, policy_folder)
    bench.until(lambda: len(commands) >= 100 and commands[-1].effort[0] != 0.0)
    hand.publish(joint(0, effort=[0.0]))
    bench.until(lambda: [message.effort[0] for message in commands[-100:]] == 100 * [0.0])
    assert ask(bench, Trigger, "controller/reset", Trigger.Request()).success
    assert ask(bench, Trigger, "controller/arm", Trigger.Request()).success
    bench.until(lambda: commands[-1].effort[0] != 0.0)


# Topics


def test_a_topic_is_carried_as_its_class_says() -> None:
    measured = topics.profile("joint_states")
    assert (measured.reliability.name, measured.durability.name, measured.depth) == ("RELIABLE", "VOLATILE", 10)
    assert topics.profile("state_estimate").depth == 1  # an old estimate has no use
    assert topics.profile("state_estimate", depth=7).depth == 7


@pytest.mark.parametrize(
    "change", [{"reliability": "sometimes"}, {"depth": "many"}, {"durability": None}, {"topics": 5}, {"reliability": 1}]
)
def test_a_wrong_class_of_topics_is_reported(tmp_path: Path, change: dict[str, Any]) -> None:
    path, sound = tmp_path / "nodes.yaml", {"reliability": "reliable", "durability": "volatile", "depth": 1}
    path.write_text(yaml.safe_dump({"qos": {"loop": {**sound, "topics": [], **change}}}), encoding="utf-8")
    with pytest.raises(UserError, match=r"nodes\.yaml: qos\.loop"):
        topics.qualities(path)


def test_a_topic_in_two_classes_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "nodes.yaml"
    quality = {"reliability": "reliable", "durability": "volatile", "depth": 1, "topics": ["joint_states"]}
    path.write_text(yaml.safe_dump({"qos": {"loop": quality, "view": quality}}), encoding="utf-8")
    with pytest.raises(UserError, match=r"qos\.view: topic joint_states is in another class"):
        topics.qualities(path)


# Parameters


@pytest.mark.parametrize(
    ("kind", "parameters", "message"),
    [
        (PlantNode, {"rate": 5e4}, "parameter rate is 50000.0 Hz: it must be within"),
        (PlantNode, {"rate": 300.0}, "parameter rate is 300 Hz: its period"),
        (PlantNode, {"rate": "fast"}, "parameter rate is 'fast'"),
        (PlantNode, {"rat": 100.0}, "unknown parameter rat: the nearest of 21 are rate"),
        (PlantNode, {"rig": "crane"}, "no rig 'crane'"),
        (EstimatorNode, {"model": "/nowhere"}, "/nowhere"),
        (ControllerNode, {"policy": "best"}, "parameter policy is 'best': choose one of supervised, network, exact"),
        (ReferenceNode, {"publish_period": 0.007}, "it must be a multiple of point_spacing"),
        (ReferenceNode, {"preview_seconds": 0.05}, "it must be more than publish_period"),
        (ReferenceNode, {"kind": "multisine", "frequency": 0.01}, "a multisine needs more than"),
    ],
)
def test_a_parameter_that_is_not_allowed_is_reported(bench: Bench, kind: Any, parameters: Any, message: str) -> None:
    with pytest.raises(UserError) as reported:
        bench.start(kind, **parameters)
    assert message in str(reported.value)
    assert "\n" not in str(reported.value)


def test_parameters_are_described_with_range_and_unit(bench: Bench) -> None:
    node = bench.start(ReferenceNode, amplitude=3, hold=2)
    assert list(node.get_parameter("amplitude").value) == [3.0]  # one number stands for all outputs
    described = node.describe_parameter("amplitude")
    assert described.description.endswith("[V]")
    assert described.additional_constraints == "each within [-10, 10]"
    assert "configured" in node.describe_parameter("preview_seconds").additional_constraints
    assert node.describe_parameter("hold").floating_point_range[0].to_value == 1000.0


def test_a_change_is_refused_with_a_reason_or_applied(bench: Bench) -> None:
    node = bench.start(PlantNode)
    for name, value, reason in (
        ("bias", [10.1], "within [-10, 10]"),
        ("bias", [0.1, 0.2], "one for each input"),
        ("bias", "much", "needs a number"),
        ("rate", 100.0, "read when the node is configured"),
    ):
        result = node.set_parameters([Parameter(name, value=value)])[0]
        assert not result.successful
        assert reason in result.reason
    assert node.settings["bias"] == [0.03]
    assert node.set_parameters([Parameter("bias", value=[0.2])])[0].successful
    assert node.settings["bias"] == [0.2]


def test_what_a_node_says_of_its_parameters_can_be_set_again(bench: Bench) -> None:
    """As by `ros2 param dump` and `load`: what is read when it is configured is no change where it is the same."""
    node = bench.start(PlantNode)
    reported = [node.get_parameter(name) for name in node.settings if name != "rig"]
    assert len(reported) >= 20
    assert all(result.successful for result in node.set_parameters(reported))


def test_topics_are_relative_names(bench: Bench) -> None:
    remapped = ["--ros-args", "-r", "reference:=/wish", "-r", "__node:=dreamer"]
    for options, name in (
        ({}, "/reference"),
        ({"namespace": "left"}, "/left/reference"),
        ({"cli_args": remapped}, "/wish"),
    ):
        node = bench.add(ReferenceNode(context=bench.context, **options))
        assert node.previews.topic_name == name


# Timing


def test_percentiles_of_durations_are_within_two_percent() -> None:
    durations = np.random.default_rng(0).lognormal(mean=-7.0, sigma=0.5, size=5000)
    histogram = Histogram()
    assert math.isnan(histogram.percentile(50))
    for duration in durations:
        histogram.add(float(duration))
    for percent in (1, 50, 99, 99.9):
        assert histogram.percentile(percent) == pytest.approx(np.percentile(durations, percent), rel=0.02)
    assert histogram.percentile(100) == histogram.longest == durations.max()


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
def test_a_driver_is_heard_whatever_it_offers(bench: Bench, model_folder: Path, reliability: ReliabilityPolicy) -> None:
    """A sensor's driver often repeats nothing that gets lost; and another one may take its place."""
    estimates = bench.listen("state_estimate")
    bench.start(EstimatorNode, model=str(model_folder), lockstep=True)
    driver = bench.probe.create_publisher(
        JointState, "joint_states", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    bench.until(driver.get_subscription_count)
    if reliability == ReliabilityPolicy.RELIABLE:
        bench.probe.destroy_publisher(driver)
        driver = bench.speak("joint_states")
        bench.until(driver.get_subscription_count)
    stamps = iter(range(100 * SECOND, 200 * SECOND, SECOND // 200))

    def answered() -> bool:
        driver.publish(joint(next(stamps), position=[0.0], effort=[0.0]))
        return len(estimates) > 3

    bench.until(answered)


def test_a_node_of_an_extension_needs_no_parameter_lockstep() -> None:
    settings = {"stamp_ahead": 1.0, "stamp_behind": 1.0, "silence": 1.0}
    node: Any = SimpleNamespace(settings=settings, validators={}, now=lambda: 0)
    assert RigNode.validator(node, "joint_command") is node.validators["joint_command"]
