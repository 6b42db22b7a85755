"""Messages between nodes of one process arrive once, in order, and never keep the loop for themselves."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.exchange import AT_ONCE, Exchange
from hybrid_sysid_ros.nodes.plant import PlantNode
from tests.node_bench import Bench


def test_messages_arrive_in_the_order_in_which_they_were_given() -> None:
    exchange, heard = Exchange(), list[bytes]()
    exchange.subscribe("/a", heard.append)
    for k in range(5):
        exchange.give("/a", bytes([k]))
        exchange.give("/b", b"nobody hears it")
    assert not exchange.deliver()
    assert heard == [bytes([k]) for k in range(5)]
    exchange.leave("/a", heard.append)
    exchange.give("/a", b"x")
    assert not exchange.deliver()
    assert len(heard) == 5


def test_an_endless_exchange_lets_others_have_their_turn() -> None:
    """Two that answer each other for ever, as plant and controller do in lockstep."""
    exchange, turns = Exchange(), list[str]()

    def answer(own: str, other: str) -> None:
        exchange.subscribe(own, lambda data: (turns.append(own), exchange.give(other, data)))  # type: ignore[func-returns-value, arg-type]

    answer("/a", "/b")
    answer("/b", "/a")
    exchange.give("/a", b"")
    assert exchange.deliver()
    assert len(turns) == AT_ONCE


def test_nodes_of_a_process_know_of_one_another(bench: Bench, domain: int) -> None:
    """Also where the middleware does not tell: a plant waits for who reads it, an estimator for who is read."""
    exchange, options = Exchange(), {"context": bench.context, "namespace": bench.namespace}
    plant, estimator = (kind(exchange=exchange, **options) for kind in (PlantNode, EstimatorNode))
    assert exchange.publishers(f"/{bench.namespace}/joint_states") == 1
    assert exchange.listeners(f"/{bench.namespace}/joint_states") == 1
    plant.trigger_deactivate()
    assert exchange.publishers(f"/{bench.namespace}/joint_states") == 0
    for node in (plant, estimator):
        node.destroy_node()
