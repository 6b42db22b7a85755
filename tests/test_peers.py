"""Peers that nothing passes to or from: the node says which, and why, and goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.plant import PlantNode
from tests.node_bench import Bench

LASTING = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def loop_of(bench: Bench, node: str) -> Callable[[], Any]:
    """The newest that a node says of its loop in the diagnostics, once it does."""
    heard = bench.listen("/diagnostics", DiagnosticArray)

    def latest() -> Any:
        found = [said for message in heard for said in message.status if said.name == f"cam_beam/{node}: loop"]
        return found[-1] if found else None

    return latest


def test_a_peer_that_asks_for_more_than_is_offered_is_named_while_it_is_there(bench: Bench) -> None:
    """A logger that wants the last message although it comes late, which no volatile publisher keeps."""
    bench.start(PlantNode, wait_for_readers=0)
    said = loop_of(bench, "plant")
    logger = bench.add(Node("logger", context=bench.context, namespace="lab"))
    logger.create_subscription(JointState, "/cam_beam/joint_states", lambda message: None, LASTING)
    words = "/cam_beam/joint_states: nothing gets to /lab/logger: volatile publisher and transient local subscription"
    reported: Any = bench.until(lambda: (found := said()) and words in found.message and found)
    assert reported.level == DiagnosticStatus.WARN
    bench.executor.remove_node(logger)
    bench.nodes.remove(logger)
    logger.destroy_node()
    bench.until(lambda: (found := said()) and "logger" not in found.message)


def test_a_publisher_that_offers_less_than_is_asked_for_is_named(bench: Bench, model_folder: Any) -> None:
    """Reliable it is, as asked for: to make do with best effort would not help."""
    override = {"qos_overrides./cam_beam/joint_states.subscription.durability": "transient_local"}
    estimator = bench.start(EstimatorNode, model=str(model_folder), **override)
    said = loop_of(bench, "estimator")
    bench.speak("joint_states")
    words = "/cam_beam/joint_states: nothing comes from /cam_beam/probe: volatile publisher"
    bench.until(lambda: (found := said()) and words in found.message)
    (subscription,) = [item for item in estimator.subscriptions if item.topic_name == "/cam_beam/joint_states"]
    assert subscription.qos_profile.reliability == ReliabilityPolicy.RELIABLE
