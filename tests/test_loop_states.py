"""States of a control loop: slowed, at rest, stopped, disarmed, and how it comes back."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from std_msgs.msg import Bool

from hybrid_sysid_ros.control.safety.failsafe import LoopState
from hybrid_sysid_ros.nodes.diagnostics import ERROR, WARN
from hybrid_sysid_ros.nodes.operation import ControllerMode, Operation
from hybrid_sysid_ros.support.errors import UserError
from tests.node_bench import VOLT, Bench
from tests.wheel import Wheel


@pytest.fixture
def wheel(bench: Bench, model_folder: Path, policy_folder: Path) -> Wheel:
    made = Wheel(bench, model_folder, policy_folder, lockstep=True)
    made.refer([VOLT] * 30)
    return made


def test_a_doubted_estimate_slows_the_loop_then_rests_it(wheel: Wheel) -> None:
    assert wheel.command(0.0, doubt=0.9) == pytest.approx(4.0)
    commands = [wheel.command(0.0, doubt=3.0) for _ in range(60)]
    assert commands[5] == pytest.approx(4.0)
    assert max(commands[21:40]) <= 2.5 + 1e-9, "a quarter of 10 V"
    assert commands[-1] == 0.0
    task = wheel.controller.health()[0]
    assert task.level == ERROR
    assert "resting: measurements contradict the model" in task.message
    assert task.values["times_resting"] == 1
    back = [wheel.command(0.0, doubt=0.1) for _ in range(150)]
    assert back[-1] == pytest.approx(4.0)
    moving = back[back.index(next(value for value in back if value > 0.0)) :]
    assert moving == sorted(moving), "the reference is led on from where the rig is"
    assert wheel.controller.operation.reached is LoopState.DRIVING


def test_told_to_tell_the_controller_drives_on(bench: Bench, model_folder: Path, policy_folder: Path) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, distrust="tell")
    wheel.refer([VOLT] * 30)
    assert [wheel.command(0.0, doubt=9.0) for _ in range(60)] == pytest.approx([4.0] * 60)
    assert "distrust is tell" in wheel.controller.health()[0].message


def test_an_estimate_that_lacks_a_sensor_is_driven_slowly(wheel: Wheel) -> None:
    assert wheel.command(0.0, sensors_left_out=1.0) == pytest.approx(2.5)
    assert wheel.controller.operation.reached is LoopState.SLOWED


def test_an_input_that_acts_reversed_is_sent_with_the_other_sign(wheel: Wheel) -> None:
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert wheel.command(0.0, sensors_left_out=1.0, input_reversed=0.0) == pytest.approx(-2.5), "and slowly"
    task = wheel.controller.health()[0]
    assert "slowed: an input acts reversed" in task.message
    assert wheel.command(0.0, sensors_left_out=0.0, input_reversed=-1.0) > 0.0


def test_an_emergency_stop_stays_until_it_is_reset_and_armed(wheel: Wheel) -> None:
    speaker = wheel.bench.probe.create_publisher(Bool, "estop", 10)
    wheel.bench.until(speaker.get_subscription_count)
    assert wheel.command(0.0) == pytest.approx(4.0)
    speaker.publish(Bool(data=True))
    wheel.bench.until(lambda: wheel.commands[-1].effort[0] == 0.0)
    speaker.publish(Bool(data=False))
    assert wheel.command(0.0) == 0.0
    assert wheel.controller.health()[0].level == WARN
    services = wheel.controller.own_services()
    for name in ("enable", "hold", "arm"):
        with pytest.raises(UserError, match="reset"):
            services[name]()
    services["reset"]()
    wheel.refer([VOLT] * 30)
    assert wheel.command(0.0) == 0.0, "reset alone does not arm"
    services["arm"]()
    back = [wheel.command(0.0) for _ in range(60)]
    assert 0.0 < back[0] < 3.5
    assert back[-1] == pytest.approx(4.0)


def test_an_operator_is_told_what_was_done_by_hand_and_what_goes_on() -> None:
    reported: list[str] = []
    operation = Operation(armed=True, tell=reported.append)
    operation.turn_to(ControllerMode.STOP)
    operation.turn_to(ControllerMode.DRIVE)
    for _ in range(2):
        operation.emergency_stop("the topic estop")
    operation.reset()
    operation.arm([])
    operation.disarm()
    latched = "disarmed (emergency stop by the topic estop)"
    assert reported == [
        "at rest: stopped until the service enable is called",
        "may move: the loop drives",
        f"at rest: {latched}: call the services reset and arm",
        f"at rest: {latched}: call the service arm",
        "may move: the loop drives",
        "at rest: disarmed (by the service disarm): call the service arm",
    ]


def test_a_rest_for_want_of_numbers_is_one_change_of_state(wheel: Wheel) -> None:
    wheel.command(0.0)
    for _ in range(60):
        wheel.command(math.nan)
    values = wheel.controller.health()[0].values
    assert (values["state"], values["times_resting"], values["times_driving"]) == ("resting", 1, 0)
    wheel.command(0.0)
    assert wheel.controller.operation.reached is LoopState.DRIVING


def test_time_that_begins_anew_does_not_end_an_emergency_stop(wheel: Wheel) -> None:
    wheel.command(0.0)
    wheel.controller.emergency_stop("a test")
    wheel.controller.forget()
    assert wheel.controller.operation.emergency


def test_a_loop_that_is_not_armed_rests_until_its_checks_pass(
    bench: Bench, model_folder: Path, policy_folder: Path
) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, armed=False)
    wheel.refer([VOLT] * 30)
    services = wheel.controller.own_services()
    with pytest.raises(UserError, match="no estimates come"):
        services["arm"]()
    assert wheel.command(0.0) == 0.0
    assert wheel.controller.health()[0].values["state"] == "disarmed"
    wheel.command(math.nan)
    with pytest.raises(UserError, match="no numbers"):
        services["arm"]()
    for _ in range(30):
        wheel.command(0.0, doubt=8.0)
    with pytest.raises(UserError, match="contradict"):
        services["arm"]()
    for _ in range(100):
        wheel.command(0.0, sensors_left_out=1.0)
    with pytest.raises(UserError, match="a sensor shows nothing or is left out"):
        services["arm"]()
    wheel.command(0.0)
    services["arm"]()
    assert wheel.command(0.0) > 0.0
    services["disarm"]()
    for _ in range(60):
        wheel.command(0.0)
    assert wheel.commands[-1].effort[0] == 0.0


def test_a_stopped_loop_comes_back_gently(wheel: Wheel) -> None:
    services = wheel.controller.own_services()
    wheel.command(0.0)
    services["stop"]()
    for _ in range(60):
        wheel.command(-VOLT)
    assert wheel.commands[-1].effort[0] == 0.0
    services["enable"]()
    first = wheel.command(-VOLT)
    assert first < 4.0, "the policy asks for 7 V to go from -1 V to 1 V at once"


def test_what_may_be_asked_of_an_operation() -> None:
    operation = Operation(armed=False)
    assert operation.state(LoopState.DRIVING) is LoopState.DISARMED
    with pytest.raises(UserError, match="arm"):
        operation.turn_to(ControllerMode.DRIVE)
    with pytest.raises(UserError, match="not ready to be armed: x"):
        operation.arm(["x"])
    operation.arm([])
    assert operation.state(LoopState.SLOWED) is LoopState.SLOWED
    operation.turn_to(ControllerMode.HOLD)
    assert operation.state(LoopState.SLOWED) is LoopState.HOLDING
    operation.turn_to(ControllerMode.STOP)
    assert operation.state(LoopState.DRIVING) is LoopState.STOPPED
    with pytest.raises(UserError, match="enable"):
        operation.turn_to(ControllerMode.HOLD)
    assert operation.state(LoopState.DRIVING) is LoopState.STOPPED, "a hold would drive a rig that rests"
    operation.emergency_stop("first")
    operation.emergency_stop("second")
    assert "first" in operation.words


def test_a_reference_that_comes_again_begins_where_the_last_one_ended(
    bench: Bench, model_folder: Path, policy_folder: Path
) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, stamp_behind=100.0, stale_after=9.9, zero_after=10.0)
    wheel.stamp = wheel.controller.now() - 9 * 10**9
    wheel.refer([0.0, 0.0], spacing=0.1)
    at_zero = wheel.command(0.0)
    assert wheel.command(0.0, step=10**9) == pytest.approx(at_zero), "the last value is held"
    wheel.refer([VOLT] * 30)
    bench.until(lambda: wheel.controller.preview is not None and wheel.controller.preview.values[0, 0] > 0.0)
    back = [wheel.command(0.0) for _ in range(60)]
    assert at_zero < back[0] < 3.5
    assert back[-1] == pytest.approx(4.0)
