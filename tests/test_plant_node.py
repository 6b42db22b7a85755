"""The plant node: what it does with sound, wrong and missing commands, in lockstep and in real time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes import plant as plant_module
from hybrid_sysid_ros.nodes.diagnostics import OK
from hybrid_sysid_ros.nodes.drive import Answers, Drive
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.validation import Reason
from hybrid_sysid_ros.rigs.actuator import Actuator
from tests.node_bench import Bench, ask, joint, stamp_of


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
    for command, applied in ((1e6, 10.0), (-math.pi * 1e8, -10.0)):
        drill.answer(command)
        assert drill.following().effort[0] == applied
    assert drill.plant.drive.saturated == 2


def test_a_command_that_makes_no_sense_is_rejected_and_counted(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True)
    drill.answer(1.5)
    drill.following()
    drill.answer(math.nan)
    drill.answer(math.inf)
    drill.answer(-1e300)
    drill.answer()
    drill.answer(3.0, name="arm")
    drill.answer(3.0, late=1)
    drill.answer(3.0, late=-7)
    bench.until(lambda: drill.plant.rejected + drill.plant.entry.dropped.total() == 7)
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
    steps = np.diff([stamp_of(message) for message in drill.measurements])
    assert (steps % (SECOND // 100) == 0).all()  # the nominal grid, however late the timer is
    assert sum(steps // (SECOND // 100) - 1) == drill.plant.overruns


def test_a_plant_that_was_held_up_leaves_out_what_it_missed(bench: Bench) -> None:
    drill = Drill(bench, rate=100.0, command_timeout=10.0)
    drill.answer(2.0)
    bench.until(lambda: drill.measurements[-1].effort[0] == 2.0)
    before, time, latest = drill.plant.overruns, drill.plant.plant.time, drill.plant.answers.latest
    late = drill.plant.time + 0.3
    while drill.plant.time < late:  # nobody turns the loop
        pass
    drill.plant.tick()
    newest = drill.plant.answers.latest
    stamp = drill.plant.answers.stamp(newest)
    assert drill.plant.overruns - before == newest - latest - 1 >= 29
    assert drill.plant.plant.time - time == pytest.approx((newest - latest) * 0.01)
    first = bench.until(lambda: [message for message in drill.measurements if stamp_of(message) == stamp])[0]
    assert first.effort[0] == 2.0


def test_a_reset_in_real_time_begins_anew_without_a_pause(bench: Bench) -> None:
    drill = Drill(bench, rate=100.0, command_timeout=10.0)
    drill.answer(5.0)
    bench.until(lambda: drill.plant.plant.time > 0.1)
    moved, count = drill.measurements[-1].position[0], len(drill.measurements)
    assert abs(moved) > 0.0
    assert ask(bench, Trigger, "plant/reset", Trigger.Request()).success
    assert drill.plant.plant.time < 0.1
    bench.until(lambda: len(drill.measurements) > count + 10)
    steps = np.diff([stamp_of(message) for message in drill.measurements[count - 1 :]])
    assert max(steps) < SECOND // 10
    assert drill.measurements[-1].effort[0] == 0.0


def test_a_person_drives_where_no_controller_does_and_stops_it_where_one_does(bench: Bench) -> None:
    drill = Drill(bench, rate=100.0, silence=0.2, command_timeout=10.0)
    plant = drill.plant

    def push(effort: float, stamp: int = 0) -> None:
        drill.commands.publish(joint(stamp, effort=[effort]))

    push(3.0)  # not stamped, as by `ros2 topic pub`
    bench.until(lambda: drill.measurements[-1].effort[0] == 3.0)
    push(2.0, plant.now())  # as a driver does
    bench.until(lambda: drill.measurements[-1].effort[0] == 2.0)
    push(4.0, plant.now() - 60 * SECOND)
    bench.until(lambda: plant.rejected == 1)
    drill.answer(1.0)
    bench.until(lambda: drill.measurements[-1].effort[0] == 1.0)
    push(5.0)
    bench.until(lambda: plant.rejected == 2)
    push(0.0)  # a stop counts always
    bench.until(lambda: drill.measurements[-1].effort[0] == 0.0)
    assert (plant.direct, plant.stops) == (2, 1)


def test_a_second_controller_is_noticed_and_not_heard(bench: Bench) -> None:
    drill = Drill(bench, rate=50.0, command_timeout=10.0)

    def say(effort: float, source: str) -> None:
        message = joint(stamp_of(drill.measurements[-1]), effort=[effort])
        message.header.frame_id = source
        drill.commands.publish(message)

    say(1.0, "first")
    bench.until(lambda: drill.measurements[-1].effort[0] == 1.0)
    say(9.0, "second")
    bench.until(lambda: drill.plant.entry.dropped[Reason.OTHER])
    say(2.0, "first")
    bench.until(lambda: drill.measurements[-1].effort[0] == 2.0)
    assert max(message.effort[0] for message in drill.measurements) == 2.0
    drill.plant.report()
    assert any("another publisher" in task.message for task in drill.plant.health()) or drill.plant.troubles


class Controlled(Drill):
    """A plant that a controller drives, beside which others speak."""

    def say(self, effort: float, source: str, stamp: int | None = None) -> None:
        message = joint(stamp_of(self.measurements[-1]) if stamp is None else stamp, effort=[effort])
        message.header.frame_id = source
        self.commands.publish(message)

    def drive(self, effort: float) -> float:
        """The controller answers; what the rig got two periods later."""
        self.say(effort, "controller")
        self.following()
        self.following()
        return float(self.measurements[-1].effort[0])

    def driven(self, effort: float) -> None:
        """The controller answers until the rig gets what it says."""
        self.bench.until(lambda: self.drive(effort) == effort)


@pytest.mark.parametrize("source", ["", "a person", "controller"])
@pytest.mark.parametrize("stamped", ["not", "now", "long ago"])
def test_somebody_else_s_zero_stops_until_the_plant_is_enabled(bench: Bench, source: str, stamped: str) -> None:
    if source == "controller" and stamped != "not":
        pytest.skip("as a controller that winds down")
    drill = Controlled(bench, rate=100.0, command_timeout=10.0)
    drill.driven(2.0)
    drill.say(0.0, source, {"not": 0, "now": drill.plant.now(), "long ago": SECOND}[stamped])
    bench.until(lambda: drill.measurements[-1].effort[0] == 0.0)
    for effort in (3.0, 0.0, 4.0):
        assert drill.drive(effort) == 0.0
    (task,) = drill.plant.health()
    assert task.level != OK
    assert "stopped by hand until the service enable" in task.message
    assert drill.plant.hand.count == 1
    assert drill.plant.hand.disobeyed >= 2
    assert ask(bench, Trigger, "plant/enable", Trigger.Request()).success
    drill.driven(3.0)


@pytest.mark.parametrize("source", ["", "ros2_topic_pub"])
def test_in_lockstep_somebody_else_s_zero_stops_too_and_time_goes_on(bench: Bench, source: str) -> None:
    """There the controller has no name, but its commands answer measurements."""
    drill = Controlled(bench, lockstep=True, rate=100.0)

    def answered(effort: float) -> float:
        drill.answer(effort)
        return float(drill.following().effort[0])

    assert answered(2.0) == 2.0
    drill.say(0.0, source, 0)
    bench.until(lambda: drill.plant.hand.count)
    assert [answered(3.0), answered(4.0)] == [0.0, 0.0]
    assert ask(bench, Trigger, "plant/enable", Trigger.Request()).success
    assert answered(3.0) == 3.0


def test_a_controller_that_stops_too_is_obeyed_again(bench: Bench) -> None:
    """From then on its own service says when it drives."""
    stopped: list[int] = []

    def stop(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        stopped.append(1)
        response.success = True
        return response

    bench.probe.create_service(Trigger, "controller/estop", stop)
    drill = Controlled(bench, rate=100.0, command_timeout=10.0)
    bench.until(drill.plant.hand._client.service_is_ready)
    drill.driven(2.0)
    drill.say(0.0, "", 0)
    bench.until(lambda: stopped and drill.plant.hand._last_old < math.inf)
    drill.following()
    drill.driven(1.0)
    assert not drill.plant.hand.latched
    drill.say(0.0, "", 0)
    bench.until(lambda: drill.measurements[-1].effort[0] == 0.0)
    assert drill.drive(1.0) == 0.0  # until it was asked again, a second later
    assert len(stopped) == 1
    drill.plant.hand._asked = -math.inf
    drill.driven(1.0)
    assert len(stopped) == 2


def test_a_stranger_s_command_is_refused_while_the_controller_lives(bench: Bench) -> None:
    drill = Controlled(bench, rate=100.0, command_timeout=10.0, silence=10.0)
    drill.driven(2.0)
    newest = stamp_of(drill.measurements[-1])
    for effort, stamp in ((5.0, 0), (5.0, drill.plant.now()), (5.0, newest), (0.0, newest)):
        drill.say(effort, "stranger", stamp)
    bench.until(lambda: drill.plant.entry.dropped[Reason.OTHER] == 4)
    drill.driven(2.0)
    assert not drill.plant.hand.count


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


def test_a_plant_that_is_started_again_does_not_wait_for_readers_that_have_left(bench: Bench) -> None:
    """A reference hears no measurements once it has begun, and a plant has the same command as at the first start."""
    assert Drill(bench, wait_for_readers=3).plant.started


def test_the_plant_runs_alone_when_told_to_and_ends_after_its_duration(bench: Bench) -> None:
    measurements = bench.listen("joint_states")
    node = bench.start(PlantNode, wait_for_readers=0, duration=0.05)
    bench.until(node.finished.done)
    assert node.answers.latest == 10
    bench.until(lambda: measurements)


def test_a_bias_can_be_set_while_the_plant_runs(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True)
    assert drill.plant.set_parameters([Parameter("bias", value=[0.5])])[0].successful
    drill.answer(0.0)
    drill.following()
    assert drill.plant.plant.bias.tolist() == [0.5]


# Commands and answers


def test_a_command_drives_from_the_moment_it_comes() -> None:
    drive = Drive([Actuator(low=-10.0, high=10.0), Actuator(low=0.5, high=2.0)], timeout=0.1)
    drive.command([2.0, 1.0], 0.0031)
    drive.command([-30.0, 1.5], 0.0052)
    assert [drive.at(t / 1e3) for t in (3, 4, 5, 6)] == [[0.0, 0.5], [2.0, 1.0], [2.0, 1.0], [-10.0, 1.5]]
    assert drive.at(0.2) == [0.0, 0.5]  # at rest is what is nearest to zero
    assert (drive.saturated, drive.timeouts) == (1, 1)


def test_commands_stay_in_their_order_when_a_delay_goes() -> None:
    drive = Drive([Actuator(low=-10.0, high=10.0)], timeout=1.0)
    drive.command([1.0], 0.10)  # late by .1
    drive.command([2.0], 0.01)
    assert [drive.at(time) for time in (0.05, 0.1)] == [[0.0], [2.0]]


def test_a_sensor_that_is_out_shows_no_number_and_the_rest_goes_on(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True, sensor_out=[1.0])
    assert all(math.isnan(position) for position in drill.measurements[0].position)
    drill.answer(2.5)
    assert drill.following().effort[0] == 2.5
    assert drill.plant.health()[0].values["sensor_out"] == [1.0]


def test_late_commands_act_later_by_as_much(bench: Bench) -> None:
    drill = Drill(bench, lockstep=True, command_delay=0.02)  # four periods
    applied = []
    for _ in range(8):
        drill.answer(5.0)
        applied.append(drill.following().effort[0])
    assert applied == [0.0] * 4 + [5.0] * 4


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
