"""The nodes in this process, on a domain of its own: what they answer to sound, wrong and missing messages.

The executor spins in the test, until what is waited for has happened; nothing sleeps.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.control import policy as policies
from hybrid_sysid_ros.control.adaptation import Correction
from hybrid_sysid_ros.control.certificate import Certificate
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.estimation import METHODS
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.signals import Signals

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from hybrid_sysid_ros.nodes import plant as plant_module  # noqa: E402
from hybrid_sysid_ros.nodes.base import RigNode  # noqa: E402
from hybrid_sysid_ros.nodes.controller import ControllerNode  # noqa: E402
from hybrid_sysid_ros.nodes.drive import Answers, Drive  # noqa: E402
from hybrid_sysid_ros.nodes.estimator import EstimatorNode  # noqa: E402
from hybrid_sysid_ros.nodes.messages import SECOND, nanoseconds, set_nanoseconds  # noqa: E402
from hybrid_sysid_ros.nodes.plant import PlantNode  # noqa: E402
from hybrid_sysid_ros.nodes.preview import Preview  # noqa: E402
from hybrid_sysid_ros.nodes.recorder import RecorderNode  # noqa: E402
from hybrid_sysid_ros.nodes.reference import ReferenceNode  # noqa: E402
from hybrid_sysid_ros.nodes.timing import Histogram  # noqa: E402

PATIENCE = 20.0  # s of waiting for an event
VOLT = math.radians(1.3)


class Bench:
    """Nodes on one executor, and a probe that publishes and keeps what it hears, in order, by topic."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.nodes: list[Node] = []
        self.heard: dict[str, list[Any]] = {}
        self.probe = Node("probe", context=self.context, namespace="cam_beam")
        self.add(self.probe)

    def add(self, node: Node) -> Node:
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def start(self, kind: Callable[..., RigNode], /, **parameters: Any) -> Any:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        return self.add(kind(context=self.context, namespace="cam_beam", parameter_overrides=overrides))

    def listen(self, topic: str, message_type: Any = JointState) -> list[Any]:
        self.heard[topic] = []
        self.probe.create_subscription(message_type, topic, self.heard[topic].append, 1000)
        return self.heard[topic]

    def speak(self, topic: str, message_type: Any = JointState) -> Any:
        return self.probe.create_publisher(message_type, topic, 10)

    def until(self, condition: Callable[[], Any]) -> Any:
        end = time.monotonic() + PATIENCE
        while not (found := condition()):
            assert time.monotonic() < end, "waited in vain"
            self.executor.spin_once(timeout_sec=0.05)
        return found

    def close(self) -> None:
        self.executor.shutdown()
        for node in reversed(self.nodes):
            node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def bench(domain: int) -> Iterator[Bench]:
    made = Bench(domain)
    yield made
    made.close()


def joint(
    stamp: int,
    *,
    name: Sequence[str] = ("beam",),
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> JointState:
    message = JointState(name=list(name), position=list(position), velocity=list(velocity), effort=list(effort))
    set_nanoseconds(message.header.stamp, stamp)
    return message


def stamp_of(message: Any) -> int:
    return nanoseconds(message.header.stamp)


# The plant


class Drill:
    """A plant whose commands the test gives."""

    def __init__(self, bench: Bench, **parameters: Any) -> None:
        self.bench = bench
        self.measurements = bench.listen("joint_states")
        self.commands = bench.speak("joint_command")
        self.plant: PlantNode = bench.start(PlantNode, **parameters)
        bench.until(lambda: self.measurements)

    def answer(self, *effort: float, name: str = "beam", late: int = 0) -> None:
        stamp = stamp_of(self.measurements[-1]) - late * self.plant.answers.period
        self.commands.publish(joint(stamp, name=[name], effort=effort))

    def following(self) -> JointState:
        count = len(self.measurements)
        return self.bench.until(lambda: self.measurements[count:])[0]


def test_in_lockstep_a_command_acts_over_the_whole_next_period(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True, rate=100.0)
    first = drill.measurements[0]
    assert list(first.name) == ["beam", "beam_filtered"]
    drill.answer(2.5)
    second = drill.following()
    assert stamp_of(second) - stamp_of(first) == SECOND // 100
    assert second.effort[0] == 2.5
    assert math.isnan(second.effort[1])


def test_the_input_is_bounded_whatever_is_commanded(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True)
    for command, applied in ((1e6, 10.0), (-math.pi * 1e300, -10.0)):
        drill.answer(command)
        assert drill.following().effort[0] == applied
    assert drill.plant.drive.saturated == 2


def test_a_command_that_makes_no_sense_is_rejected_and_counted(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True)
    drill.answer(1.5)
    drill.following()
    drill.answer(math.nan)
    drill.answer(math.inf)
    drill.answer()
    drill.answer(3.0, name="arm")
    drill.answer(3.0, late=1)
    drill.answer(3.0, late=-7)
    bench.until(lambda: drill.plant.rejected == 6)
    drill.answer(2.0)
    assert drill.following().effort[0] == 2.0
    assert len(drill.measurements) == 3


def test_in_real_time_the_input_is_zero_once_commands_stop(bench: Bench) -> None:
    drill = Drill(bench, rate=100.0, command_timeout=0.03)
    drill.answer(2.0)
    bench.until(lambda: drill.measurements[-1].effort[0] == 2.0)
    bench.until(lambda: drill.measurements[-1].effort[0] == 0.0)
    assert drill.plant.drive.timeouts == 1
    assert drill.plant.answers.missed > 0
    stamps = np.array([stamp_of(message) for message in drill.measurements])
    assert (np.diff(stamps) == SECOND // 100).all()  # the nominal grid without a gap, however late the timer is


def test_in_lockstep_an_unanswered_measurement_is_repeated_as_it_was(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plant_module, "ANSWER_TIMEOUT", 0.05)
    drill = Drill(bench, lockstep=True)
    bench.until(lambda: len(drill.measurements) > 2)
    assert drill.measurements[1] == drill.measurements[0] or math.isnan(drill.measurements[0].effort[1])
    assert {stamp_of(message) for message in drill.measurements} == {SECOND}
    assert {message.position[0] for message in drill.measurements} == {drill.measurements[0].position[0]}


def test_the_plant_waits_for_a_controller(bench: Bench) -> None:
    measurements = bench.listen("joint_states")
    node = bench.start(PlantNode)
    bench.until(lambda: node.measurements.get_subscription_count())
    assert not node.is_matched()
    bench.speak("joint_command")
    bench.until(lambda: measurements)


def test_the_plant_runs_alone_when_told_to_and_ends_after_its_duration(bench: Bench) -> None:
    measurements = bench.listen("joint_states")
    node = bench.start(PlantNode, wait_for_readers=0, duration=0.05)
    bench.until(node.finished.done)
    assert node.answers.latest == 10
    bench.until(lambda: measurements)


def test_a_bias_can_be_set_while_the_plant_runs(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True)
    assert drill.plant.set_parameters([Parameter("bias", value=0.5)])[0].successful
    drill.answer(0.0)
    drill.following()
    assert drill.plant.plant.bias == 0.5


# The estimator


class Desk:
    """An estimator whose measurements the test makes: the beam at rest, held by its friction."""

    period = SECOND // 200

    def __init__(self, bench: Bench, model: Path, **parameters: Any) -> None:
        self.bench = bench
        self.measurements = bench.speak("joint_states")
        self.estimates = bench.listen("state_estimate")
        self.estimator: EstimatorNode = bench.start(EstimatorNode, model=str(model), **parameters)
        bench.until(self.measurements.get_subscription_count)
        bench.until(lambda: self.estimator.estimates and self.estimator.estimates.get_subscription_count())
        self.stamp = 100 * SECOND

    def measure(self, position: float, *, step: int = 1, name: str = "beam") -> None:
        self.stamp += step * self.period
        self.measurements.publish(joint(self.stamp, name=[name], position=[position], effort=[1.0]))

    def estimate(self, position: float, **options: Any) -> JointState:
        count = len(self.estimates)
        self.measure(position, **options)
        return self.bench.until(lambda: self.estimates[count:])[0]


def test_every_measurement_is_answered_under_its_stamp(bench: Bench, model_folder: Path) -> None:
    desk = Desk(bench, model_folder)
    for _ in range(50):
        answer = desk.estimate(0.01)
        assert stamp_of(answer) == desk.stamp
    assert list(answer.name) == ["beam", "beam_ahead"]
    assert answer.position[0] == pytest.approx(0.01, abs=1e-3)
    assert answer.velocity[1] == pytest.approx(0.0, abs=1e-2)
    assert answer.effort[0] == answer.effort[1]


def test_followed_parameters_travel_with_the_estimate(bench: Bench, model_folder: Path, rig: Rig) -> None:
    """A beam that rises evenly under a volt has less friction than the model, or its centre lower."""
    desk = Desk(bench, model_folder, followed="coulomb=0.5 centre=0.1", disturbance_noise=0.0)
    for k in range(100):
        answer = desk.estimate(2e-4 * k)
    known = rig.equation.named._asdict()
    assert list(answer.name) == ["beam", "beam_ahead", "beam_coulomb", "beam_centre"]
    coulomb, centre = answer.position[2:]
    assert 0.0 <= coulomb == desk.estimator.parameters["coulomb"] < known["coulomb"]
    assert centre == desk.estimator.parameters["centre"] < known["centre"]
    assert all(math.isnan(value) for value in [*answer.velocity[2:], *answer.effort[2:]])
    # To whoever has the equation as it was, a lower centre is an input offset upwards.
    assert answer.effort[0] == pytest.approx(known["centre"] - centre)


@pytest.mark.parametrize("method", ["ukf", "mhe"])
def test_every_method_answers(bench: Bench, model_folder: Path, method: str) -> None:
    desk = Desk(bench, model_folder, method=method)
    for _ in range(30):
        answer = desk.estimate(0.01)
    assert answer.position[0] == pytest.approx(0.01, abs=1e-3)
    assert type(desk.estimator.filter) is METHODS[method]


def test_frames_of_a_camera_correct_the_estimate_and_are_not_answered(bench: Bench, model_folder: Path) -> None:
    desk = Desk(bench, model_folder, camera_noise_volts=0.01)
    for _ in range(30):
        desk.estimate(0.0)
    for late in (4, 2):  # in any order
        frame = joint(desk.stamp - late * desk.period, name=["beam_camera"], position=[0.0])
        desk.measurements.publish(frame)
    bench.until(lambda: desk.estimator.seen == 2)
    desk.estimate(0.0)
    assert len(desk.estimates) == 31
    assert desk.estimator.filter.counters.delayed == 2


def test_a_measurement_that_is_no_number_is_predicted_over(bench: Bench, model_folder: Path) -> None:
    desk = Desk(bench, model_folder)
    desk.estimate(0.01)
    assert math.isfinite(desk.estimate(math.nan).position[0])
    assert math.isfinite(desk.estimate(0.01, name="arm").position[0])
    counters = desk.estimator.filter.counters
    assert (counters.invalid, desk.estimator.malformed) == (3, 1)  # the arm's message lacks the beam's input as well


def test_a_first_measurement_that_is_no_number_is_not_answered(bench: Bench, model_folder: Path) -> None:
    desk = Desk(bench, model_folder)
    desk.measure(math.nan)
    bench.until(lambda: desk.estimator.unusable)
    assert desk.estimate(0.01).position[0] == 0.01
    assert len(desk.estimates) == 1


def test_a_gap_is_counted_and_what_comes_late_is_used_or_ignored_but_not_answered(
    bench: Bench, model_folder: Path
) -> None:
    desk = Desk(bench, model_folder)
    desk.estimate(0.01)
    desk.estimate(0.01, step=4)
    counters = desk.estimator.filter.counters
    assert counters.missing == 3
    desk.measure(0.01, step=-2)  # within the gap
    bench.until(lambda: counters.delayed)
    desk.measure(0.01, step=-50)  # before anything known
    bench.until(lambda: counters.late)
    desk.estimate(0.01, step=53)
    assert len(desk.estimates) == 3


def test_a_repeated_measurement_is_answered_again_without_being_used(bench: Bench, model_folder: Path) -> None:
    desk = Desk(bench, model_folder)
    first = desk.estimate(0.01)
    again = desk.estimate(0.01, step=0)
    assert again == first
    assert desk.estimator.filter.counters.updates == 1


def test_stamps_that_begin_again_begin_a_new_experiment(bench: Bench, model_folder: Path) -> None:
    desk = Desk(bench, model_folder)
    desk.estimate(0.01)
    desk.stamp = 10 * SECOND
    assert desk.estimate(-0.02).position[0] == -0.02
    assert desk.estimator.restarts == 1


# The controller


class Wheel:
    """A controller whose estimates the test makes."""

    def __init__(self, bench: Bench, model: Path, network: Path, /, **parameters: Any) -> None:
        self.bench = bench
        self.estimates = bench.speak("state_estimate")
        self.references = bench.speak("reference", JointTrajectory)
        self.commands = bench.listen("joint_command")
        self.controller: ControllerNode = bench.start(
            ControllerNode, **{"model": str(model), "policy_path": str(network), "policy": "network", **parameters}
        )
        bench.until(
            lambda: (
                self.controller.commands
                and self.controller.commands.get_subscription_count()
                and self.estimates.get_subscription_count()
                and self.references.get_subscription_count()
            )
        )
        self.stamp = SECOND

    def estimate(self, position: float, **followed: float) -> None:
        names, rest = ["beam", "beam_ahead", *followed], [0.0] * (2 + len(followed))
        positions = [position, position, *followed.values()]
        message = joint(self.stamp, name=names, position=positions, velocity=rest, effort=rest)
        self.estimates.publish(message)

    def command(self, position: float, *, step: int = SECOND // 200, **followed: float) -> float:
        count = len(self.commands)
        self.stamp += step
        self.estimate(position, **followed)
        answer = self.bench.until(lambda: self.commands[count:])[0]
        assert stamp_of(answer) == self.stamp
        assert list(answer.name) == ["beam"]
        return float(answer.effort[0])

    def refer(self, positions: Sequence[float], *, spacing: float = 0.5, name: str = "beam") -> None:
        message = JointTrajectory(joint_names=[name])
        set_nanoseconds(message.header.stamp, self.stamp)
        for number, position in enumerate(positions):
            point = JointTrajectoryPoint(positions=[position])
            set_nanoseconds(point.time_from_start, round(number * spacing * SECOND))
            message.points.append(point)
        self.references.publish(message)


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


def test_a_policy_drives_the_beam_to_its_reference(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 3)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.command(VOLT) == pytest.approx(1.0)


def test_parameters_that_the_estimator_follows_move_a_network_with_a_correction(
    bench: Bench, model_folder: Path, policy_folder: Path, tmp_path: Path
) -> None:
    """Half a volt more for each unit of Coulomb friction above 2; without an estimate of it, as before."""
    plain = policies.load(policy_folder)
    features, limit = len(plain.centre), plain.problem.input_limit
    layers = ((np.zeros((1, features)), np.zeros(1)), (np.zeros((1, 1)), np.array([0.5 / limit])))
    ones = {"nominal": np.array([2.0]), "spread": np.array([1.0])}
    correction = Correction(names=("coulomb",), layers=layers, **ones)
    dataclasses.replace(plain, correction=correction).save(tmp_path / "adaptive")
    wheel = Wheel(bench, model_folder, tmp_path / "adaptive", lockstep=True)
    wheel.refer([VOLT] * 3)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.command(0.0, beam_coulomb=3.0) == pytest.approx(4.5)
    assert wheel.command(0.0) == pytest.approx(4.5)
    assert wheel.command(0.0, beam_coulomb=1.5) == pytest.approx(3.75)


def test_without_a_sound_estimate_the_command_is_held_then_zero(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 5)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.command(math.nan) == pytest.approx(4.0)
    assert wheel.command(math.nan, step=SECOND // 2) == 0.0
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.controller.layers == {"policy": 2, "held": 1, "zeroed": 1}


def test_a_reference_that_makes_no_sense_is_rejected(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 3)
    wheel.command(0.0)
    wheel.refer([5 * VOLT, math.nan])
    wheel.bench.until(lambda: wheel.controller.rejected_references == 1)
    wheel.refer([5 * VOLT] * 2, name="arm")
    wheel.bench.until(lambda: wheel.controller.rejected_references == 2)
    wheel.refer([5 * VOLT] * 2, spacing=0.0)
    wheel.bench.until(lambda: wheel.controller.rejected_references == 3)
    wheel.refer([])
    wheel.bench.until(lambda: wheel.controller.rejected_references == 4)
    assert wheel.command(0.0) == pytest.approx(4.0)


def test_in_real_time_the_beam_is_held_where_it_is_until_a_reference_comes(
    bench: Bench, model_folder: Path, policy_folder: Path
) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stale_after=10.0, zero_after=10.0)
    wheel.stamp = wheel.controller.now()
    assert wheel.command(VOLT) == pytest.approx(1.0)
    assert wheel.controller.layers["no reference"] == 1


def test_an_estimate_that_is_too_old_is_not_acted_upon(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder)
    wheel.stamp = wheel.controller.now() - 5 * SECOND
    assert wheel.command(VOLT) == 0.0
    assert wheel.controller.layers == {"zeroed": 1}


def test_when_estimates_stop_the_controller_sends_a_zero(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stale_after=5.0, zero_after=0.1)
    wheel.stamp = wheel.controller.now()
    wheel.command(VOLT)
    bench.until(lambda: wheel.commands[-1].effort[0] == 0.0)


def test_the_exact_mpc_answers_and_shows_its_plan(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, policy="exact")
    plans: list[JointTrajectory] = []
    bench.probe.create_subscription(
        JointTrajectory, "predicted_trajectory", plans.append, rclpy.qos.qos_profile_sensor_data
    )
    bench.until(wheel.controller.predictions.get_subscription_count)
    wheel.refer([VOLT] * 3)
    assert 1.0 < wheel.command(0.0) <= 10.0
    bench.until(lambda: plans)
    assert len(plans[0].points) == wheel.controller.controller.horizon
    assert plans[0].points[-1].positions[0] == pytest.approx(VOLT, rel=0.1)


def test_the_exact_mpc_keeps_a_rate_limit(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, policy="exact", rate_limit=0.5)
    wheel.refer([VOLT] * 3)
    commands = [wheel.command(0.0) for _ in range(4)]
    np.testing.assert_allclose(np.diff(commands, prepend=0.0), 0.5, atol=1e-6)


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
    wheel = Wheel(bench, model_folder, planning_folder, lockstep=True, policy="supervised", check_patience=2)
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
    values: Any = wheel.controller.health()[2]
    assert values["layer_exact"] == wheel.controller.layers["exact"]
    solved = values.get("status_solved", 0) + values.get("status_not_converged", 0)  # at rest friction has corners
    assert solved == values["layer_exact"]
    assert values["check_costlier_than_the_shifted_plan"] >= 2
    checks = [count for name, count in values.items() if name.startswith("check_")]
    assert sum(checks) == values["commands"] == 10


def test_a_network_of_first_inputs_can_t_be_supervised(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    with pytest.raises(UserError, match="gives 1 of the 20 inputs of a plan"):
        bench.start(ControllerNode, model=str(model_folder), policy_path=str(policy_folder))


def test_a_certificate_must_be_the_policy_s_own_and_may_be_required(
    bench: Bench, model_folder: Path, planning_folder: Path
) -> None:
    given = {"model": str(model_folder), "policy_path": str(planning_folder), "policy": "network"}
    with pytest.raises(UserError, match="has no certificate: hybrid-sysid policy certify"):
        bench.start(ControllerNode, **given, certificate="require")
    seal = storage.digest(planning_folder, kind="policy")
    made = Certificate(
        policy=seal,
        model=policies.load(planning_folder).model,
        loops=30_000,
        seed=0,
        delta=0.01,
        distribution={},
        criteria={},
        rates={"network": {"all": 1.0}},
        check={},
        exact={},
        worst=[],
        made={},
    )
    made.save(planning_folder)
    bench.start(ControllerNode, **given, certificate="require")
    path = planning_folder / "certificate.yaml"
    path.write_text(path.read_text().replace("loops: 30000", "loops: 90000"))
    with pytest.raises(UserError, match="was altered") as told:
        bench.start(ControllerNode, **given)
    assert "\n" not in str(told.value)


# All together


def closed_loop(domain: int, model: Path, policy: Path, steps: int) -> tuple[list[JointState], list[float]]:
    bench = Bench(domain)
    try:
        measurements, commands = bench.listen("joint_states"), bench.listen("joint_command")
        bench.start(ReferenceNode, lockstep=True)
        bench.start(EstimatorNode, model=str(model), latency=0.0)
        network = {"policy": "network", "policy_path": str(policy)}
        bench.start(ControllerNode, model=str(model), lockstep=True, latency=0.0, **network)
        bench.start(PlantNode, lockstep=True, wait_for_readers=3, seed=5)
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


def test_a_recorded_bag_is_a_record(domain: int, tmp_path: Path, model_folder: Path, policy_folder: Path) -> None:
    bench = Bench(domain)
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"))
    bench.start(ReferenceNode, lockstep=True)
    bench.start(EstimatorNode, model=str(model_folder), latency=0.0)
    network = {"policy": "network", "policy_path": str(policy_folder)}
    bench.start(ControllerNode, model=str(model_folder), lockstep=True, latency=0.0, **network)
    plant = bench.start(PlantNode, lockstep=True, wait_for_readers=3, duration=1.0)
    bench.until(plant.finished.done)
    plant.report()
    bench.until(lambda: recorder.received["/cam_beam/joint_states"] == 201 and recorder.received["/diagnostics"])
    recorder.close()
    bench.close()
    record = bags.read(tmp_path / "bag", Signals.of_rig("cam_beam"))
    assert (record.samples, record.sampling_time) == (201, 0.005)
    assert set(record.channels) == {"filtered", "reference", "command"}
    np.testing.assert_allclose(record.input[:-2, 0], record.channels["command"][:-2], atol=1e-12)
    recorded = bags.topics(tmp_path / "bag")
    assert recorded["/cam_beam/state_estimate"].messages > 190
    assert "/diagnostics" in recorded


def test_a_recorder_takes_topics_of_other_types_when_they_appear(bench: Bench, tmp_path: Path) -> None:
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="temperature /diagnostics")
    publisher = bench.speak("temperature")
    bench.until(publisher.get_subscription_count)
    publisher.publish(joint(SECOND, effort=[1.0]))
    bench.until(lambda: recorder.received.get("/cam_beam/temperature"))
    recorder.close()
    assert bags.topics(tmp_path / "bag")["/cam_beam/temperature"].type == "sensor_msgs/msg/JointState"


def test_a_recorder_does_not_replace_a_bag_unasked(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").touch()
    with pytest.raises(UserError, match="exists already"):
        bench.start(RecorderNode, path=str(tmp_path / "bag"))
    with pytest.raises(UserError, match="parameter path is empty"):
        bench.start(RecorderNode)


# The reference


@pytest.mark.parametrize("kind", ["hardware", "constant", "steps", "sine", "multisine"])
def test_previews_agree_where_they_overlap(bench: Bench, kind: str) -> None:
    measurements = bench.speak("joint_states")
    previews = bench.listen("reference", JointTrajectory)
    reference = bench.start(ReferenceNode, kind=kind, lockstep=True)
    bench.until(lambda: measurements.get_subscription_count() and reference.previews.get_subscription_count())
    for k in range(40):
        measurements.publish(joint(3 * SECOND + k * SECOND // 200))
        bench.executor.spin_once(timeout_sec=0.1)
    bench.until(lambda: len(previews) == 4)  # every 50 ms of 195 ms
    first, second = (Preview.of(message, "beam") for message in previews[:2])
    assert first is not None
    assert second is not None
    times = 3 * SECOND + np.arange(60, 480, 3) * SECOND // 1000
    assert (first.at(times) == second.at(times)).all()
    assert np.abs(first.positions).max() <= 4.0 * VOLT * (1 + 1e-9)


def test_a_reference_ends_after_its_duration(bench: Bench) -> None:
    measurements = bench.speak("joint_states")
    reference = bench.start(ReferenceNode, kind="sine", duration=0.5, lockstep=True)
    bench.until(measurements.get_subscription_count)
    measurements.publish(joint(SECOND))
    bench.until(lambda: reference.zero)
    assert not reference.finished.done()
    measurements.publish(joint(SECOND + SECOND // 2))
    bench.until(reference.finished.done)


def test_a_preview_is_straight_between_points_and_held_beyond() -> None:
    preview = Preview(np.array([10, 20, 40]), np.array([1.0, 2.0, 0.0]))
    np.testing.assert_allclose(preview.at(np.array([0, 10, 15, 20, 30, 40, 99])), [1, 1, 1.5, 2, 1, 0, 0])
    np.testing.assert_allclose(Preview(np.array([10]), np.array([3.0])).at(np.array([0, 99])), [3, 3])


# Parameters


@pytest.mark.parametrize(
    ("kind", "parameters", "message"),
    [
        (PlantNode, {"rate": 5e3}, "parameter rate is 5000.0 Hz: it must be within [1, 1000]"),
        (PlantNode, {"rate": 300.0}, "parameter rate is 300 Hz: its period must be a whole number of 0.001 s"),
        (PlantNode, {"rate": "fast"}, "parameter rate is 'fast': it needs a number"),
        (PlantNode, {"rat": 100.0}, "unknown parameter rat: known are rig, rate"),
        (PlantNode, {"rig": "crane"}, "no configuration for a rig 'crane'"),
        (EstimatorNode, {"model": "/nowhere"}, "/nowhere"),
        (ControllerNode, {"policy": "best"}, "parameter policy is 'best': choose one of supervised, network, exact"),
        (ReferenceNode, {"publish_period": 0.007}, "it must be a multiple of point_spacing"),
        (ReferenceNode, {"preview_seconds": 0.05}, "it must be more than publish_period"),
        (ReferenceNode, {"kind": "multisine", "frequency": 0.01}, "a multisine needs more than"),
    ],
)
def test_a_parameter_that_is_not_allowed_is_told(bench: Bench, kind: Any, parameters: Any, message: str) -> None:
    with pytest.raises(UserError) as told:
        bench.start(kind, **parameters)
    assert message in str(told.value)
    assert "\n" not in str(told.value)


def test_parameters_are_described_with_range_and_unit(bench: Bench) -> None:
    node = bench.start(ReferenceNode, amplitude=3)
    assert node.get_parameter("amplitude").value == 3.0
    described = node.describe_parameter("amplitude")
    assert described.description.endswith("[V]")
    assert described.floating_point_range[0].to_value == 10.0
    assert described.read_only
    assert "multisine" in node.describe_parameter("kind").additional_constraints


def test_a_change_is_refused_with_a_reason_or_applied(bench: Bench) -> None:
    node = bench.start(PlantNode)
    for name, value, reason in (
        ("bias", 50.0, "out of range"),
        ("bias", "much", "Wrong"),
        ("rate", 100.0, "read-only"),
    ):
        result = node.set_parameters([Parameter(name, value=value)])[0]
        assert not result.successful
        assert reason in result.reason
    assert node.settings["bias"] == 0.03
    assert node.set_parameters([Parameter("bias", value=0.2)])[0].successful
    assert node.settings["bias"] == 0.2


def test_without_a_namespace_topics_are_in_that_of_the_rig(bench: Bench) -> None:
    node = bench.add(ReferenceNode(context=bench.context))
    assert node.previews.topic_name == "/cam_beam/reference"
    other = bench.add(ReferenceNode(context=bench.context, namespace="left"))
    assert other.previews.topic_name == "/left/reference"


# Their tools


def test_a_command_drives_from_the_moment_it_comes() -> None:
    drive = Drive(limit=10.0, timeout=0.1)
    drive.command(2.0, 0.0031)
    drive.command(-30.0, 0.0052)
    assert [drive.at(t / 1e3) for t in (3, 4, 5, 6)] == [0.0, 2.0, 2.0, -10.0]
    assert drive.at(0.2) == 0.0
    assert (drive.saturated, drive.timeouts) == (1, 1)


def test_a_measurement_without_a_command_before_the_next_one_is_missed() -> None:
    answers = Answers(start=SECOND, period=5_000_000)
    for number in range(3):
        answers.measured(number, 0.005 * number)
    assert answers.missed == 0  # nobody has commanded yet
    assert answers.answer(answers.stamp(1), 0.0112)
    assert not answers.answer(answers.stamp(1), 0.0113)  # twice
    assert not answers.answer(answers.stamp(0), 0.0114)  # older than the last one
    assert not answers.answer(answers.stamp(2) + 1, 0.0115)  # no measurement's stamp
    answers.measured(3, 0.015)
    assert (answers.missed, answers.last_missed) == (1, 2)
    assert answers.delay.total.longest == pytest.approx(0.0062)


def test_percentiles_of_durations_are_within_two_percent() -> None:
    durations = np.random.default_rng(0).lognormal(mean=-7.0, sigma=0.5, size=5000)
    histogram = Histogram()
    assert math.isnan(histogram.percentile(50))
    for duration in durations:
        histogram.add(float(duration))
    for percent in (1, 50, 99, 99.9):
        assert histogram.percentile(percent) == pytest.approx(np.percentile(durations, percent), rel=0.02)
    assert histogram.percentile(100) == histogram.longest == durations.max()
