"""The controller node: its layers, from the network under supervision down to a zero."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.control.controller import MpcSolution, Status, held
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.policy import Correction
from hybrid_sysid_ros.control.safety.certificate import Certificate, SeedCounts
from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.control.safety.guard import LEFT_OUT
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.diagnostics import OK, WARN
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds
from hybrid_sysid_ros.nodes.validation import Reason
from tests.node_bench import VOLT, Bench
from tests.wheel import Wheel


@pytest.fixture
def wheel(bench: Bench, model_folder: Path, policy_folder: Path) -> Wheel:
    return Wheel(bench, model_folder, policy_folder, lockstep=True)


def test_in_lockstep_an_estimate_waits_for_a_reference_that_covers_its_preview(wheel: Wheel) -> None:
    wheel.estimate(0.0)
    wheel.bench.until(lambda: wheel.controller.waiting)
    wheel.refer([VOLT] * 2, spacing=0.1)
    wheel.bench.until(lambda: wheel.controller.preview)
    assert not wheel.commands
    wheel.refer([VOLT] * 2)
    wheel.bench.until(lambda: wheel.commands)
    assert wheel.commands[0].effort[0] == pytest.approx(1.0 + 3.0)


def test_an_estimate_that_waits_may_come_again(wheel: Wheel) -> None:
    wheel.estimate(0.0)
    wheel.bench.until(lambda: wheel.controller.waiting)
    wheel.estimate(0.0)  # of a plant that lacks an answer
    wheel.bench.until(lambda: wheel.controller.repeated)
    assert not wheel.commands
    wheel.refer([VOLT] * 2)
    wheel.bench.until(lambda: wheel.commands)


def test_a_policy_drives_the_beam_to_its_reference(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 3)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.command(VOLT) == pytest.approx(1.0)


def test_parameters_that_the_estimator_follows_move_a_network_with_a_correction(
    bench: Bench, model_folder: Path, policy_folder: Path, tmp_path: Path
) -> None:
    """Half a volt more for each unit of Coulomb friction above 2; without an estimate of it, as before."""
    plain = policies.load(policy_folder)
    features, limit = len(plain.centre), plain.problem.input_high[0]
    layers = ((np.zeros((1, features)), np.zeros(1)), (np.zeros((1, 1)), np.array([0.5 / limit])))
    ones = {"nominal": np.array([2.0]), "spread": np.array([1.0])}
    correction = Correction(names=("coulomb",), layers=layers, **ones)
    dataclasses.replace(plain, correction=correction).save(tmp_path / "adaptive")
    wheel = Wheel(bench, model_folder, tmp_path / "adaptive", lockstep=True)
    wheel.refer([VOLT] * 3)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.command(0.0, coulomb=3.0) == pytest.approx(4.5)
    assert wheel.command(0.0) == pytest.approx(4.5)
    assert wheel.command(0.0, coulomb=1.5) == pytest.approx(3.75)


def test_a_report_tells_of_a_loop_that_was_slowed_since_the_last_one(wheel: Wheel) -> None:
    """A disconnected actuator slows a loop for .07 s in every .17 s, and a report comes every .4 s."""
    wheel.refer([VOLT] * 3)
    wheel.command(0.0)
    wheel.controller.health()
    guard = wheel.controller.adapter.guard
    guard.judge(0.0, 1.0, math.nan, np.zeros(1), np.zeros(1), np.zeros(2), 0.005)  # a sensor is left out
    wheel.command(0.0)
    assert guard.level is LoopState.DRIVING
    (told, _), (calm, _) = wheel.controller.health()[:2], wheel.controller.health()[:2]
    assert (told.level, told.message) == (WARN, f"driving: {LEFT_OUT}")
    assert calm.message != told.message


def test_without_a_sound_estimate_the_command_is_held_then_zero(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 5)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.command(math.nan) == pytest.approx(4.0)
    assert wheel.command(math.nan, step=SECOND // 2) == 0.0
    commands = [wheel.command(0.0) for _ in range(30)]
    assert commands == sorted(commands), "the reference begins where the rig is and moves on"
    assert 0.0 < commands[0] < 3.5
    assert commands[-1] == pytest.approx(4.0)
    assert wheel.controller.layers == {"policy": 31, "held": 1, "zeroed": 1}


def test_what_stands_in_for_a_plan_becomes_zero(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, zero_after=0.2)
    wheel.refer([VOLT] * 5)
    assert wheel.command(0.0) == pytest.approx(4.0)

    def none(state: Any, disturbance: Any, previous: Any, preview: Any) -> MpcSolution:
        return held(previous, wheel.controller.adapter.problem, Status.FAILED)

    parts = {
        "prepare": lambda elapsed: None,
        "reset": lambda: None,
        "horizon": wheel.controller.adapter.controller.horizon,
        "period": 0.02,
    }
    wheel.controller.adapter.controller = SimpleNamespace(control=none, **parts)
    commands = [wheel.command(0.0) for _ in range(50)]
    assert commands[:39] == [pytest.approx(4.0)] * 39  # .2 s at 200 Hz
    assert commands[41:] == [0.0] * 9


def test_the_last_command_is_a_zero(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stale_after=5.0, zero_after=10.0)
    wheel.stamp = wheel.controller.now() - SECOND // 10
    assert wheel.command(VOLT) == pytest.approx(1.0)
    wheel.controller.close()
    bench.until(lambda: wheel.commands[-1].effort[0] == 0.0)


def test_a_reference_ends_before_the_travel_does(wheel: Wheel) -> None:
    """The beam's sensor sees +-10 V; a reference of 44 V is held a little before that."""
    wheel.refer([44 * VOLT] * 5)
    wheel.command(0.0)
    assert wheel.controller.clipped == 1
    assert wheel.controller.preview is not None
    assert np.all(wheel.controller.preview.values == pytest.approx(9.6 * VOLT))


def test_a_reference_without_a_stamp_begins_now(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stale_after=5.0, zero_after=10.0)
    wheel.stamp = 0
    wheel.refer([VOLT] * 3)
    bench.until(lambda: wheel.controller.preview)
    assert abs(wheel.controller.preview.times[0] - wheel.controller.now()) < SECOND  # type: ignore[union-attr]


def test_simulated_time_that_stands_or_jumps_back(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    clock = bench.probe.create_publisher(Clock, "/clock", 10)
    wheel = Wheel(bench, model_folder, policy_folder, use_sim_time=True, stale_after=0.09, zero_after=0.1)
    bench.until(clock.get_subscription_count)
    wheel.estimate(VOLT)  # no clock has shown its time yet
    bench.until(lambda: wheel.controller.entry.dropped[Reason.AHEAD] == 1)
    assert not wheel.commands
    for start in (100 * SECOND, 40 * SECOND):
        wheel.stamp = start
        message = Clock()
        set_nanoseconds(message.clock, start)
        clock.publish(message)
        bench.until(lambda: wheel.controller.now() == start)  # noqa: B023
        assert wheel.command(VOLT, step=0) == pytest.approx(1.0)
        bench.until(lambda: wheel.commands[-1].effort[0] == 0.0)  # time stands, the watchdog does not


def test_a_reference_that_makes_no_sense_is_rejected(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 3)
    wheel.command(0.0)
    wheel.refer([5 * VOLT, math.nan])
    wheel.bench.until(lambda: wheel.controller.wishes.dropped.total() == 1)
    wheel.refer([5 * VOLT] * 2, name="arm")
    wheel.bench.until(lambda: wheel.controller.wishes.dropped.total() == 2)
    wheel.refer([5 * VOLT] * 2, spacing=0.0)
    wheel.bench.until(lambda: wheel.controller.wishes.dropped.total() == 3)
    wheel.refer([])
    wheel.bench.until(lambda: wheel.controller.wishes.dropped.total() == 4)
    assert wheel.command(0.0) == pytest.approx(4.0)


def test_in_real_time_the_beam_is_held_where_it_is_until_a_reference_comes(
    bench: Bench, model_folder: Path, policy_folder: Path
) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stale_after=9.0, zero_after=10.0)
    wheel.stamp = wheel.controller.now()
    assert wheel.command(VOLT) == pytest.approx(1.0)
    assert wheel.controller.layers["no reference"] == 1


def test_an_estimate_that_is_too_old_is_not_acted_upon(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stale_after=0.03, zero_after=0.2)
    wheel.stamp = wheel.controller.now() - SECOND // 10
    assert wheel.command(VOLT) == 0.0
    assert wheel.controller.layers == {"zeroed": 1}
    wheel.stamp -= 5 * SECOND
    wheel.estimate(VOLT)
    bench.until(lambda: wheel.controller.entry.dropped[Reason.LONG_PAST])


def test_when_estimates_stop_the_controller_sends_a_zero(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stale_after=0.9, zero_after=1.0)
    wheel.stamp = wheel.controller.now()
    wheel.command(VOLT)
    bench.until(lambda: wheel.commands[-1].effort[0] == 0.0)


def test_the_exact_mpc_answers_and_shows_its_plan(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, policy="exact")
    plans: list[JointTrajectory] = []
    bench.probe.create_subscription(JointTrajectory, "predicted_trajectory", plans.append, qos_profile_sensor_data)
    bench.until(wheel.controller.output.predictions.get_subscription_count)
    wheel.refer([VOLT] * 3)
    assert 1.0 < wheel.command(0.0) <= 10.0
    bench.until(lambda: plans)
    assert len(plans[0].points) == wheel.controller.adapter.controller.horizon
    assert plans[0].points[-1].positions[0] == pytest.approx(VOLT, rel=0.1)


def test_the_input_changes_no_faster_than_it_may(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, policy="exact", input_rate=100.0)
    wheel.refer([VOLT] * 3)
    commands = [wheel.command(0.0) for _ in range(4)]
    assert commands[0] == pytest.approx(100.0 * wheel.controller.adapter.controller.period)  # since no command before
    np.testing.assert_allclose(np.diff(commands), 100.0 * 0.005, atol=1e-6)


@pytest.fixture
def planning_folder(model_folder: Path, policy_folder: Path, tmp_path: Path) -> Path:
    """The rig's P controller again, which means to hold its input for the whole horizon."""
    policy = policies.load(policy_folder)
    hidden, (matrix, bias) = policy.layers
    outputs = policy.horizon
    wide = np.full(len(policy.centre), 1e6)
    network = dataclasses.replace(
        policy,
        layers=(hidden, (np.repeat(matrix, outputs, axis=0), np.repeat(bias, outputs))),
        training_range=dataclasses.replace(policy.training_range, low=-wide, high=wide, reach=1e9),
    )
    features = policy.check[0]
    folder = tmp_path / "planning"
    dataclasses.replace(network, check=(features, network.evaluate(features))).save(folder)
    return folder


def test_under_supervision_the_network_drives_while_its_plans_are_good(
    bench: Bench, model_folder: Path, planning_folder: Path
) -> None:
    """At rest on the reference the P controller's plan is as good as any; from afar it is not."""
    given = {"lockstep": True, "policy": "supervised", "check_patience": 2, "check_step": [0.0]}
    wheel = Wheel(bench, model_folder, planning_folder, **given)
    wheel.refer([0.0] * 3)
    at_rest = [wheel.command(0.0) for _ in range(4)]
    assert at_rest[-1] == pytest.approx(1.0)
    assert wheel.controller.layers == {"exact": 1, "policy": 3}
    far = [wheel.command(2 * VOLT) for _ in range(2)]
    assert all(abs(command - (1.0 - 6.0)) > 0.1 for command in far)
    assert wheel.controller.layers == {"exact": 3, "policy": 3}
    for _ in range(4):
        wheel.command(0.0)
    assert wheel.controller.layers["policy"] > 3
    values: Any = wheel.controller.report()
    assert values["layer_exact"] == wheel.controller.layers["exact"]
    solved = values.get("status_solved", 0) + values.get("status_not_converged", 0)  # at rest friction has corners
    assert solved == values["layer_exact"]
    assert values["check_costlier_than_the_shifted_plan"] >= 2
    checks = [count for name, count in values.items() if name.startswith("check_")]
    assert sum(checks) == values["commands"] == 10


def test_a_network_of_first_inputs_can_t_be_supervised(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    with pytest.raises(UserError, match="can't be checked"):
        bench.start(ControllerNode, model=str(model_folder), policy_path=str(policy_folder))


def test_a_certificate_must_be_the_policy_s_own_and_may_be_required(
    bench: Bench, model_folder: Path, planning_folder: Path
) -> None:
    given = {"model": str(model_folder), "policy_path": str(planning_folder), "policy": "network"}
    for asks in ("check", "require"):
        with pytest.raises(UserError, match=r"has no certificate .*; certificate:=ignore uses it all the same"):
            bench.start(ControllerNode, **given, certificate=asks)
    seal = storage.digest(planning_folder, kind="policy")
    counts = SeedCounts(
        seed=0,
        loops={"steps": 30_000},
        failed={"network": {"steps": {"all": 3}}, "supervised": {"steps": {"all": 15_000}}},
        check={},
        exact={},
        made={},
    )
    made = Certificate(
        policy=seal,
        model=policies.load(planning_folder).model,
        delta=0.01,
        distribution={},
        criteria={},
        ledger=[counts],
        worst=[],
    )
    made.save(planning_folder)
    bench.start(ControllerNode, **given, certificate="require")
    with pytest.raises(UserError, match=r"says 0\.9996 of network in steps, less than certificate_rate 0\.9999"):
        bench.start(ControllerNode, **given, certificate_rate=0.9999)
    bench.start(ControllerNode, **given, certificate_rate=0.9999, certificate="ignore")
    given["policy"] = "supervised"
    with pytest.raises(UserError, match=r"says 0\.49\d\d of supervised in steps, less than certificate_rate 0\.99"):
        bench.start(ControllerNode, **given, certificate="require")
    doubted = bench.start(ControllerNode, **given).health()[1]
    assert doubted.level == WARN
    assert "of supervised in steps, less than certificate_rate 0.99" in doubted.message
    assert bench.start(ControllerNode, **given, certificate="ignore").health()[1].level == OK
    path = planning_folder / "certificate.yaml"
    path.write_text(path.read_text().replace("steps: 30000", "steps: 90000"))
    with pytest.raises(UserError, match="was altered") as reported:
        bench.start(ControllerNode, **given)
    assert "\n" not in str(reported.value)


def test_bare_numbers_are_there_for_who_reads_them(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    """As a forward_command_controller takes them: an array in the order of the inputs."""
    wheel = Wheel(bench, model_folder, policy_folder)
    numbers = bench.listen("effort_command", Float64MultiArray)
    bench.until(lambda: wheel.controller.output.wanted)
    wheel.stamp = wheel.controller.now()
    wheel.refer([VOLT] * 9)
    bench.until(lambda: wheel.controller.preview)
    wheel.stamp = wheel.controller.now()
    answer = wheel.command(0.0, step=0)
    assert list(bench.until(lambda: [item for item in numbers if item.data[0] == answer])[0].data) == [answer]
