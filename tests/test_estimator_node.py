"""The estimator node: what it answers to sound, wrong, late and missing measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from hybrid_sysid_ros.estimation import estimator_class
from hybrid_sysid_ros.rigs.rig import Rig

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from sensor_msgs.msg import JointState

from hybrid_sysid_ros.nodes.diagnostics import OK
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.validation import Reason
from tests.node_bench import Bench, joint, stamp_of

VALIDITY = ["beam_applied", "doubt", "sensors_left_out", "input_reversed"]
"""Entries of an estimate that say how far to trust it."""


class Clients:
    """An estimator whose measurements the test makes: the beam at rest, held by its friction."""

    period = SECOND // 200

    def __init__(self, bench: Bench, model: Path, **parameters: Any) -> None:
        self.bench = bench
        self.measurements = bench.speak("joint_states")
        self.frames = bench.speak("camera/joint_states")
        self.estimates = bench.listen("state_estimate")
        self.estimator: EstimatorNode = bench.start(
            EstimatorNode, **{"model": str(model), "lockstep": True, "frozen_after": 0.0, **parameters}
        )
        bench.until(self.measurements.get_subscription_count)
        bench.until(lambda: self.estimator.estimates and self.estimator.estimates.get_subscription_count())
        self.stamp = 100 * SECOND

    def measure(self, position: float, *, step: int = 1, name: str = "beam", effort: Sequence[float] = (1.0,)) -> None:
        self.stamp += step * self.period
        self.measurements.publish(joint(self.stamp, name=[name], position=[position], effort=effort))

    def estimate(self, position: float, **options: Any) -> JointState:
        count = len(self.estimates)
        self.measure(position, **options)
        return self.bench.until(lambda: self.estimates[count:])[0]


def test_every_measurement_is_answered_under_its_stamp(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder)
    for _ in range(50):
        answer = clients.estimate(0.01)
        assert stamp_of(answer) == clients.stamp
    assert list(answer.name) == ["beam", "beam_ahead", *VALIDITY]
    assert answer.position[0] == pytest.approx(0.01, abs=1e-3)
    assert answer.velocity[1] == pytest.approx(0.0, abs=1e-2)
    assert answer.effort[0] == answer.effort[1]


def test_followed_parameters_travel_with_the_estimate(bench: Bench, model_folder: Path, rig: Rig) -> None:
    """A beam that rises evenly under a volt has less friction than the model, or its centre lower."""
    clients = Clients(bench, model_folder, followed="coulomb=0.5 centre=0.1", disturbance_noise=0.0)
    for k in range(100):
        answer = clients.estimate(2e-4 * k)
    known = rig.system.named
    assert list(answer.name) == ["beam", "beam_ahead", *VALIDITY, "coulomb", "centre"]
    coulomb, centre = answer.position[-2:]
    assert 0.0 <= coulomb == clients.estimator.adapter.parameters["coulomb"] < known["coulomb"]
    assert centre == clients.estimator.adapter.parameters["centre"] < known["centre"]
    assert all(math.isnan(value) for value in [*answer.velocity[2:], *answer.effort[3:]])
    # To whoever has the equation as it was, a lower centre is an input offset upwards.
    assert answer.effort[0] == pytest.approx(known["centre"] - centre)


@pytest.mark.parametrize("method", ["ukf", "mhe"])
def test_every_method_answers(bench: Bench, model_folder: Path, method: str) -> None:
    clients = Clients(bench, model_folder, method=method)
    for _ in range(30):
        answer = clients.estimate(0.01)
    assert answer.position[0] == pytest.approx(0.01, abs=1e-3)
    assert type(clients.estimator.adapter.estimator.filter) is estimator_class(method)


def test_frames_of_a_camera_correct_the_estimate_and_are_not_answered(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder, camera_noise=0.01)
    for _ in range(30):
        clients.estimate(0.0)
    for late in (4, 2):  # in any order
        frame = joint(clients.stamp - late * clients.period, name=["beam_camera"], position=[0.0])
        clients.frames.publish(frame)
    bench.until(lambda: clients.estimator.seen == 2)
    clients.estimate(0.0)
    assert len(clients.estimates) == 31
    assert clients.estimator.adapter.estimator.filter.counters.delayed == 2


def test_a_measurement_that_is_no_number_is_predicted_over(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder)
    clients.estimate(0.01)
    assert math.isfinite(clients.estimate(math.nan).position[0])
    clients.measure(0.01, name="arm")  # of others, who share the topic
    assert math.isfinite(clients.estimate(0.01).position[0])
    counters = clients.estimator.adapter.estimator.filter.counters
    assert counters.invalid == 1
    assert clients.estimator.entry.dropped == {Reason.NO_NUMBER: 1, Reason.UNRELATED: 1}


@pytest.mark.parametrize("effort", [[math.nan], []], ids=["NaN", "none"])
def test_an_effort_that_is_not_known_is_no_fault(bench: Bench, model_folder: Path, effort: list[float]) -> None:
    clients = Clients(bench, model_folder)
    for _ in range(20):
        answer = clients.estimate(0.01, effort=effort)
    assert answer.position[0] == pytest.approx(0.01, abs=1e-3)
    assert not clients.estimator.entry.dropped
    assert {task.name: task.level for task in clients.estimator.health()}.items() >= {"loop": OK, "sensor": OK}.items()
    clients.estimate(0.01, effort=[math.inf])
    assert clients.estimator.entry.dropped == {Reason.OUT_OF_RANGE: 1}
    assert clients.estimator.adapter.estimator.filter.counters.unknown_inputs == 20


def test_a_command_stands_for_an_effort_that_is_not_known(bench: Bench, model_folder: Path) -> None:
    clients, commands = Clients(bench, model_folder), bench.speak("joint_command")
    clients.estimate(0.01, effort=[])
    bench.until(commands.get_subscription_count)
    commands.publish(joint(clients.stamp, name=["beam"], position=[], effort=[1.0]))
    bench.until(lambda: clients.estimator.adapter.commanded[0] == 1.0)
    counters = clients.estimator.adapter.estimator.filter.counters
    unknown = counters.unknown_inputs
    answer = clients.estimate(0.01, effort=[])
    assert counters.unknown_inputs == unknown
    assert math.isnan(answer.effort[list(answer.name).index("beam_applied")]), "what acts is still not known"


def test_a_first_measurement_that_is_no_number_is_not_answered(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder)
    clients.measure(math.nan)
    bench.until(lambda: clients.estimator.unusable)
    assert clients.estimate(0.01).position[0] == 0.01
    assert len(clients.estimates) == 1


def test_a_gap_is_counted_and_what_comes_late_is_used_or_ignored_but_not_answered(
    bench: Bench, model_folder: Path
) -> None:
    clients = Clients(bench, model_folder)
    clients.estimate(0.01)
    clients.estimate(0.01, step=4)
    counters = clients.estimator.adapter.estimator.filter.counters
    assert counters.missing == 3
    clients.measure(0.01, step=-2)  # within the gap
    bench.until(lambda: counters.delayed)
    clients.measure(0.01, step=-50)  # before anything known
    bench.until(lambda: counters.late)
    clients.estimate(0.01, step=53)
    assert len(clients.estimates) == 3


def test_without_readings_estimates_end(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder, sensor_timeout=0.1)
    clients.estimate(0.01)
    answers = [clients.estimate(math.nan) for _ in range(25)]
    assert all(math.isfinite(answer.position[0]) for answer in answers[:20])
    assert all(math.isnan(answer.position[0]) for answer in answers[20:])
    assert math.isfinite(clients.estimate(0.01).position[0])
    assert clients.estimator.blind == 5


def test_a_sensor_with_noise_that_shows_the_same_number_is_frozen(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder, frozen_after=0.1, sensor_timeout=0.1)
    answers = [clients.estimate(0.01) for _ in range(50)]
    assert math.isfinite(answers[35].position[0])
    assert math.isnan(answers[-1].position[0])
    assert any("the same reading of position" in task.message for task in clients.estimator.health())
    assert math.isnan(clients.estimate(0.0101).position[0]), "one count of the converter is less than its noise"
    assert math.isfinite(clients.estimate(0.012).position[0])


def test_a_repeated_measurement_is_answered_again_without_being_used(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder)
    first = clients.estimate(0.01)
    again = clients.estimate(0.01, step=0)
    assert str(again) == str(first), "not equal by its numbers, for NaN is no number"
    assert clients.estimator.adapter.estimator.filter.counters.updates == 1


def test_stamps_that_begin_again_begin_a_new_experiment(bench: Bench, model_folder: Path) -> None:
    clients = Clients(bench, model_folder)
    clients.estimate(0.01)
    clients.stamp = 10 * SECOND
    clients.measure(-0.02)  # one alone may be a fault
    assert clients.estimate(-0.02).position[0] == -0.02
    assert clients.estimator.restarts == 1


@pytest.mark.parametrize(("rate", "words"), [(100.0, "sooner than"), (400.0, "missing")])
def test_a_wrong_rate_is_named(bench: Bench, model_folder: Path, rate: float, words: str) -> None:
    """Measurements at 200 Hz, where others are expected."""
    clients = Clients(bench, model_folder, rate=rate)
    for _ in range(20):
        clients.estimate(0.01)
    assert words in clients.estimator.health()[0].message
