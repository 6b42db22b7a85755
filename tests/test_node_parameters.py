"""Parameters of nodes: rules between them, and what changes while a loop runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import ReliabilityPolicy

from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.parameters import parameter_file
from hybrid_sysid_ros.support.errors import UserError
from tests.manager import set_parameter
from tests.node_bench import VOLT, Bench
from tests.test_estimator_node import Clients
from tests.wheel import Wheel


@pytest.fixture
def wheel(bench: Bench, model_folder: Path, policy_folder: Path) -> Wheel:
    return Wheel(bench, model_folder, policy_folder, lockstep=True)


@pytest.mark.parametrize(
    ("kind", "parameters", "reason"),
    [
        (
            ControllerNode,
            {"stale_after": 0.1, "zero_after": 0.1},
            "zero_after is 0.1 s: it must be more than",
        ),
        (ControllerNode, {"stale_after": 0.01}, "stale_after is 0.01 s: it must be more than period, 0.02 s"),
        (
            EstimatorNode,
            {"innovation_warn": 40.0},
            "30, its default: it must be more than innovation_warn, 40",
        ),
    ],
)
def test_rules_between_parameters_are_kept(bench: Bench, kind: Any, parameters: Any, reason: str) -> None:
    with pytest.raises(UserError) as reported:
        bench.start(kind, **parameters)
    assert reason in str(reported.value)


def test_a_live_parameter_keeps_to_the_rules(bench: Bench) -> None:
    bench.start(ReferenceNode)
    assert "more than warn_share" in set_parameter(bench, "reference", "warn_share", 0.5)
    assert set_parameter(bench, "reference", "warn_share", 0.1) == ""


def test_a_file_may_be_for_all_nodes(bench: Bench, tmp_path: Path) -> None:
    """The generated file, which has every parameter of every node, and one section for all."""
    path = tmp_path / "all.yaml"
    path.write_text(parameter_file("cam_beam") + "/**:\n  ros__parameters: {horizon: 30, gate: 9.0}\n")
    arguments = ["--ros-args", "--params-file", str(path)]
    node = bench.add(ReferenceNode(context=bench.context, cli_args=arguments))
    assert not node.has_parameter("horizon")
    path.write_text("/**:\n  ros__parameters: {horizn: 30}\n")
    with pytest.raises(UserError, match="unknown parameter horizn"):
        ReferenceNode(context=bench.context, cli_args=arguments)


def test_qualities_of_service_are_taken_or_refused(bench: Bench) -> None:
    name = f"qos_overrides./{bench.namespace}/joint_states.publisher"
    node = bench.start(PlantNode, **{f"{name}.reliability": "best_effort", f"{name}.depth": 3})
    assert node.measurements.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert node.measurements.qos_profile.depth == 3
    for wrong, value, reason in (
        (f"{name}.reliability", "maybe", "choose one of reliable, best_effort"),
        (f"{name}.depth", 0, "a whole number within 1"),
        (f"{name}.deadline", 3, "needs the form qos_overrides.TOPIC.publisher|subscription.reliability"),
        ("qos_overrides./other.publisher.depth", 3, "has no publisher of /other"),
    ):
        with pytest.raises(UserError) as reported:
            bench.start(PlantNode, **{wrong: value})
        assert reason in str(reported.value)


def test_weights_change_while_the_loop_runs(bench: Bench, model_folder: Path) -> None:
    """A change of the input that costs more is smaller, and that of a controller which had that price at first."""

    def first(**parameters: Any) -> tuple[Wheel, float]:
        wheel = Wheel(bench, model_folder, Path(), policy="exact", policy_path="", lockstep=True, **parameters)
        wheel.refer([VOLT] * 9)
        return wheel, wheel.command(0.0)

    dear, wanted = first(rate_weight=50.0)
    bench.executor.remove_node(dear.controller)
    dear.controller.destroy_node()
    wheel, cheap = first()
    assert abs(wanted) < abs(cheap)
    assert set_parameter(bench, "controller", "rate_weight", 50.0) == ""
    wheel.controller.input[:] = 0.0
    assert wheel.command(0.0) == pytest.approx(wanted, abs=1e-6)
    assert "it must be within" in set_parameter(bench, "controller", "rate_weight", -1.0)


def test_policies_are_exchanged_while_the_loop_runs(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 9)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert "/nowhere" in set_parameter(wheel.bench, "controller", "policy_path", "/nowhere")
    assert "the network keeps the one" in set_parameter(wheel.bench, "controller", "output_weight", 1.0)
    assert wheel.command(VOLT) == pytest.approx(1.0)
    assert set_parameter(wheel.bench, "controller", "policy", "exact") == ""
    wheel.command(VOLT)
    assert wheel.controller.layers["exact"] == 1


def test_an_estimator_that_takes_other_noise_goes_on_where_it_was(bench: Bench, model_folder: Path) -> None:
    """At rest with an unknown offset of the input, which takes a while to be found."""
    clients = Clients(bench, model_folder)
    for _ in range(300):
        before = clients.estimate(0.2)
    assert set_parameter(bench, "estimator", "measurement_noise", 0.02) == ""
    assert clients.estimator.adapter.estimator.tuning.measurement_noise[0] == pytest.approx(
        load_rig("cam_beam").display[0].si(0.02)
    )
    after = clients.estimate(0.2)
    assert after.position[0] == pytest.approx(before.position[0], abs=1e-3)
    assert after.effort[0] == pytest.approx(before.effort[0], abs=0.1 * abs(before.effort[0]) + 1e-3)
    assert "/nowhere" in set_parameter(bench, "estimator", "model", "/nowhere")
    assert clients.estimate(0.2).position[0] == pytest.approx(after.position[0], abs=1e-3)


def test_a_reference_changes_while_it_is_published(bench: Bench) -> None:
    node = bench.start(ReferenceNode, kind="constant", amplitude=1.0, lockstep=True)
    assert set_parameter(bench, "reference", "kind", "sine") == ""
    assert node.choice.kind == "sine"
    assert "choose one of constant" in set_parameter(bench, "reference", "kind", "walk")
    assert node.choice.kind == "sine"
