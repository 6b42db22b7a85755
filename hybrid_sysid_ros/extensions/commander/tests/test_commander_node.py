"""The commander node: what is said becomes a set-point of the reference node, or a refusal; a stop goes before all."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from threading import Thread
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.extensions.commander.nodes import (
    command_client,
    commander,
    configured_interpreter,
    waiting_commands,
)
from hybrid_sysid_ros.extensions.commander.nodes.command_client import CommandClient
from hybrid_sysid_ros.extensions.commander.nodes.commander import CommanderNode
from hybrid_sysid_ros.extensions.commander.nodes.controller_report import ControllerReport
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.operation import ControllerMode
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.support.errors import UserError
from tests.node_bench import VOLT, Bench, joint


class AtOnce(Thread):
    """Runs where it is started."""

    def start(self) -> None:
        self.run()


@pytest.fixture(autouse=True)
def interpreting(monkeypatch: pytest.MonkeyPatch) -> None:
    """An interpreter is compiled and simulated within a turn of the executor, however long that takes on this machine,
    and gives way to nobody: here is no loop in real time.
    """
    monkeypatch.setattr(configured_interpreter, "Thread", AtOnce)
    for module in (configured_interpreter, commander):
        monkeypatch.setattr(module, "give_way", lambda: None)


class DrivenRig:
    """A loop of a rig in lockstep with a commander, and whoever speaks to it."""

    def __init__(self, bench: Bench, **parameters: Any) -> None:
        self.bench = bench
        self.controller = bench.start(ControllerNode, policy="exact", lockstep=True, latency=0.0)
        bench.start(EstimatorNode, lockstep=True, latency=0.0)
        bench.start(ReferenceNode, kind="constant", amplitude=0.0, lockstep=True)
        self.commander = bench.start(CommanderNode, **parameters)
        self.text = bench.speak("command_text", String)
        self.replies = bench.listen("command_reply", DiagnosticStatus)
        self.references = bench.listen("reference", JointTrajectory)
        self.set_points = bench.listen("set_point", JointTrajectory)
        bench.until(lambda: self.commander.interpreting.interpreter)  # alone: in lockstep a loop never rests
        self.plant = bench.start(PlantNode, lockstep=True, wait_for_readers=0, bias=0.0)
        bench.until(lambda: self.references)
        bench.until(lambda: "state_estimate" in self.commander.monitor.newest)
        bench.until(lambda: "reference" in self.commander.monitor.newest)

    def say(self, text: str) -> DiagnosticStatus:
        """What is replied to a text when it was checked."""
        count = len(self.replies)

        def answers() -> list[DiagnosticStatus]:
            return [reply for reply in self.replies[count:] if state(reply) != "checks"]

        self.text.publish(String(data=text))
        self.bench.until(answers)
        return answers()[0]

    def call(self, service: str, kind: Any = Trigger, **request: Any) -> Any:
        client = self.bench.probe.create_client(kind, service)
        self.bench.until(client.service_is_ready)
        answer = client.call_async(kind.Request(**request))
        return self.bench.until(lambda: answer.done() and answer.result())

    def set(self, text: str) -> Any:
        wanted = [Parameter("command", value=text).to_parameter_msg()]
        return self.call("commander/set_parameters", SetParameters, parameters=wanted).results[0]


@pytest.fixture
def loop(bench: Bench) -> Iterator[DrivenRig]:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # all nodes and the simulation are threads of one Python here
    made = DrivenRig(bench, armed=True)
    yield made
    made.commander.deactivate()
    sys.setswitchinterval(interval)


def state(reply: DiagnosticStatus) -> str:
    return next(item.value for item in reply.values if item.key == "state")


def test_a_sentence_moves_the_rig_to_where_it_says(loop: DrivenRig) -> None:
    reply = loop.say("go to 1 V")
    assert (state(reply), reply.level) == ("begins", DiagnosticStatus.OK)
    assert any(item.key.startswith("peak drive") for item in reply.values)
    loop.bench.until(lambda: abs(loop.commander.monitor.shown_outputs()[0] - 1.0) < 0.05)
    assert loop.references[-1].points[-1].positions[0] == pytest.approx(VOLT)
    loop.bench.until(lambda: state(loop.replies[-1]) == "done")


def test_what_can_t_be_is_refused_and_nothing_is_published(loop: DrivenRig) -> None:
    for text, why in (("hold 3", "of what"), ("hold 300 V", "reach"), ("hold $(reboot) V", "means nothing")):
        reply = loop.say(text)
        assert (state(reply), reply.level) == ("refused", DiagnosticStatus.ERROR)
        assert why in reply.message
    assert not loop.set_points


def test_the_parameter_tells_the_reason(loop: DrivenRig) -> None:
    refused = loop.set("hold 3")
    assert not refused.successful
    assert "of what" in refused.reason
    assert loop.set("go to 1 V").successful
    loop.bench.until(lambda: loop.set_points)


def test_disarmed_a_plan_waits_until_it_is_confirmed(loop: DrivenRig) -> None:
    assert loop.call("commander/arm", SetBool, data=False).success
    assert not loop.call("commander/confirm").success
    assert state(loop.say("go to 1 V")) == "waits"
    assert not loop.set_points
    assert loop.call("commander/confirm").success
    loop.bench.until(lambda: loop.set_points)
    assert not loop.call("commander/confirm").success


def test_a_stop_drops_the_plan_and_disarms(loop: DrivenRig) -> None:
    loop.say("swing between -1 and 1 V at 1 Hz for 2 s")
    assert loop.call("commander/stop").success
    loop.bench.until(lambda: loop.controller.operation.mode is ControllerMode.STOP)
    assert not loop.commander.armed
    count = len(loop.set_points)
    loop.bench.until(lambda: len(loop.set_points) > count - 1 and len(loop.set_points[-1].points) == 1)
    assert state(loop.say("go to 1 V")) == "waits"
    assert loop.controller.operation.mode is ControllerMode.STOP
    assert loop.call("commander/confirm").success
    loop.bench.until(lambda: loop.controller.operation.mode is ControllerMode.DRIVE)
    assert not loop.commander.get_parameter("armed").value
    wanted = [Parameter("armed", value=True).to_parameter_msg()]
    assert loop.call("commander/set_parameters", SetParameters, parameters=wanted).results[0].successful
    assert loop.commander.armed


@pytest.mark.parametrize("text", ["stop", "STOP!!", "please stop it now", "oh dear stop"])
def test_stop_is_understood_while_a_plan_is_checked(loop: DrivenRig, text: str) -> None:
    loop.text.publish(String(data="swing between -1 and 1 V at 0.5 Hz for 100 s"))
    loop.bench.until(lambda: loop.commander.checking)
    assert state(loop.say(text)) == "stopped"
    loop.bench.until(lambda: loop.controller.operation.mode is ControllerMode.STOP)
    assert loop.commander.running is None
    assert loop.commander.ready is None


def test_an_emergency_stays_until_the_controller_is_reset_and_armed(loop: DrivenRig) -> None:
    loop.say("swing between -1 and 1 V at 1 Hz for 2 s")
    assert "reset and armed" in loop.say("cut the power!").message
    loop.bench.until(lambda: loop.controller.operation.emergency)
    refused = loop.say("go to 1 V")
    assert state(refused) == "refused"
    assert "nothing moves" in refused.message
    assert "reset and arm" in refused.message
    assert not loop.call("controller/enable").success


@pytest.mark.parametrize(
    ("service", "way"), [("stop", "until the service enable"), ("hold", "until the service enable"), ("estop", "reset")]
)
def test_a_plan_is_broken_off_and_the_next_refused_where_the_controller_moves_nothing(
    loop: DrivenRig, service: str, way: str
) -> None:
    assert state(loop.say("swing between -1 and 1 V at 0.5 Hz for 60 s")) == "begins"
    assert loop.call(f"controller/{service}").success
    loop.bench.until(lambda: state(loop.replies[-1]) == "stopped")
    assert "broken off: nothing moves" in loop.replies[-1].message
    assert loop.commander.running is None
    refused = loop.say("go to 1 V")
    assert state(refused) == "refused"
    assert way in refused.message
    if service != "estop":
        assert loop.call("controller/enable").success
        loop.bench.until(lambda: not loop.commander.monitor.standstill)
        found = loop.say("go to 2 V in 0.5 s")  # beyond the swing, which may have ended anywhere
        assert state(found) == "begins", found.message
        loop.bench.until(lambda: state(loop.replies[-1]) == "done")


@pytest.mark.parametrize("first", ["commander", "controller"])
def test_what_somebody_else_has_stopped_is_not_enabled_by_a_plan(loop: DrivenRig, first: str) -> None:
    """Whether that was before the commander's own stop, or behind it."""
    second = {"commander": "controller", "controller": "commander"}[first]
    assert loop.call(f"{first}/stop").success
    loop.bench.until(lambda: loop.commander.monitor.controller.stops)
    assert loop.call(f"{second}/stop").success
    loop.bench.until(lambda: not loop.commander.stopped)
    refused = loop.say("go to 1 V")
    assert state(refused) == "refused"
    assert "until the service enable" in refused.message
    assert not loop.call("commander/confirm").success
    assert loop.controller.operation.mode is ControllerMode.STOP


def test_what_a_controller_says_becomes_what_to_do() -> None:
    assert ControllerReport("driving").standstill == ""
    assert "activate it" in ControllerReport("inactive").standstill
    assert "holding (innovation): wait" in ControllerReport("holding", "innovation").standstill
    disarmed = "disarmed (not armed yet): call the service arm"
    assert ControllerReport("disarmed", disarmed).standstill == f"nothing moves: the controller is {disarmed}"


def test_stop_works_while_the_commander_is_not_configured(bench: Bench) -> None:
    controller = bench.start(ControllerNode, policy="exact", lockstep=True, latency=0.0)
    commander = bench.start(CommanderNode, autostart=False)
    bench.until(commander.controller.stopper.service_is_ready)
    client = bench.probe.create_client(Trigger, "commander/stop")
    bench.until(client.service_is_ready)
    client.call_async(Trigger.Request())
    bench.until(lambda: controller.operation.mode is ControllerMode.STOP)
    with pytest.raises(Exception, match="activate"):
        commander.obey("hold 1 V")


def test_before_it_can_simulate_hold_is_no_stop(bench: Bench) -> None:
    controller = bench.start(ControllerNode, policy="exact", lockstep=True, latency=0.0)
    node = bench.start(CommanderNode)  # no estimator: nothing says how to simulate
    text = bench.speak("command_text", String)
    bench.until(lambda: node.controller.stopper.service_is_ready() and text.get_subscription_count())
    with pytest.raises(UserError, match="no estimator"):
        node.obey("hold")
    assert (node.stops, controller.operation.mode) == (0, ControllerMode.DRIVE)
    text.publish(String(data="hold it, stop"))
    bench.until(lambda: controller.operation.mode is ControllerMode.STOP)
    assert node.stops == 1


def test_a_sum_that_ends_in_stop_stops_at_its_end(loop: DrivenRig) -> None:
    loop.say("go to 1 V in 0.5 s then stop")
    loop.bench.until(lambda: loop.controller.operation.mode is ControllerMode.STOP)
    assert loop.commander.monitor.shown_outputs()[0] == pytest.approx(1.0, abs=0.2)


def test_repeat_does_the_last_again(loop: DrivenRig) -> None:
    assert "repeat" in loop.say("repeat").message
    loop.say("go up by 0.5 V in 0.2 s")
    loop.bench.until(lambda: state(loop.replies[-1]) == "done")
    loop.say("again")
    loop.bench.until(lambda: state(loop.replies[-1]) == "done")
    assert loop.references[-1].points[-1].positions[0] == pytest.approx(VOLT)


def test_the_plan_that_is_published_is_the_simulation(loop: DrivenRig) -> None:
    planned = loop.bench.listen("planned", JointTrajectory)
    loop.bench.until(loop.commander.planned.get_subscription_count)
    loop.say("go to 2 V in 1 s then wait 1 s")
    loop.bench.until(lambda: planned)
    final = planned[0].points[-1]
    assert final.positions[0] / VOLT == pytest.approx(2.0, abs=0.1)
    assert np.abs([point.effort[0] for point in planned[0].points]).max() <= 10.0


def test_what_waits_for_standstill_begins_when_nothing_moves_any_more(loop: DrivenRig) -> None:
    loop.say("go to 1 V in 0.5 s, and once it is still go to 2 V in 0.5 s")
    loop.bench.until(lambda: loop.commander.awaited)
    assert abs(loop.references[-1].points[-1].positions[0] / VOLT - 1.0) < 1e-6
    loop.bench.until(lambda: loop.references[-1].points[-1].positions[0] / VOLT == pytest.approx(2.0))


def test_a_stop_may_wait_and_leaves_what_runs_alone_until_then(loop: DrivenRig) -> None:
    loop.say("swing between -1 and 1 V at 0.5 Hz for 20 s")
    assert "after 0.5 s" in loop.say("in 0.5 s stop").message
    assert loop.commander.running is not None
    loop.bench.until(lambda: loop.controller.operation.mode is ControllerMode.STOP)
    assert loop.commander.running is None


def test_a_stop_that_waits_is_not_dropped_by_the_next_command(loop: DrivenRig) -> None:
    loop.say("stop if it reaches 1 V")
    assert "'stop if it reaches 1 V' waits still" in loop.say("go to 2 V in 3 s").message
    assert "one condition is watched" in loop.say("once it is still go to 0 V").message
    loop.bench.until(lambda: loop.controller.operation.mode is ControllerMode.STOP)
    assert loop.commander.monitor.shown_outputs()[0] < 1.5


def test_a_stop_at_a_value_on_the_way_comes_on_the_way(loop: DrivenRig) -> None:
    assert "; but once position reaches 1 V" in loop.say("go to 2 V in 4 s and stop when it reaches 1 V").message
    loop.bench.until(lambda: loop.controller.operation.mode is ControllerMode.STOP)
    assert loop.commander.monitor.shown_outputs()[0] == pytest.approx(1.0, abs=0.3)


def test_a_condition_that_never_comes_is_reported_and_left_out(
    loop: DrivenRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waiting_commands, "PATIENCE", 0.1)
    loop.say("when it reaches 5 V, go to 2 V")
    loop.bench.until(lambda: state(loop.replies[-1]) == "refused")
    assert "left out" in loop.replies[-1].message
    assert loop.commander.awaited is None


def test_what_waits_for_where_the_motion_ends_comes_there(loop: DrivenRig) -> None:
    loop.say("go to 2 V in 0.5 s, and when it reaches 2 V go to 1 V in 0.5 s")
    loop.bench.until(lambda: loop.commander.awaited)
    loop.bench.until(lambda: loop.references[-1].points[-1].positions[0] / VOLT == pytest.approx(1.0))


def test_undo_goes_back_to_where_the_last_command_began(loop: DrivenRig) -> None:
    loop.say("go to 1 V in 0.2 s")
    loop.bench.until(lambda: state(loop.replies[-1]) == "done")
    loop.say("undo that")
    loop.bench.until(lambda: state(loop.replies[-1]) == "done")
    assert loop.references[-1].points[-1].positions[0] == pytest.approx(0.0, abs=1e-9)


@pytest.fixture
def context(domain: int) -> Context:
    """Of a client."""
    made = Context()
    rclpy.init(context=made, domain_id=domain)
    return made


class Caller:
    """Calls a client, whose calls wait for answers, in threads of their own while the nodes of a bench go on."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.pool = bench, ThreadPoolExecutor(2)

    def __call__(self, action: Callable[..., Any], *given: Any, **named: Any) -> Any:
        answer = self.pool.submit(action, *given, **named)
        self.bench.until(answer.done)
        return answer.result()


def test_a_client_tells_where_the_rig_is_and_what_would_come_of_a_command(
    loop: DrivenRig, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the tools for language models ask for it."""
    monkeypatch.setattr(command_client, "LIVE", 60.0)
    call = Caller(loop.bench)
    client = call(CommandClient, loop.commander.rig, context=context)
    assert call(client.say, "go to 1 V in 0.2 s").line.startswith("begins")
    loop.bench.until(lambda: state(loop.replies[-1]) == "done")
    # The end of the motion and its last reference come by topics of their own, in either order.
    loop.bench.until(lambda: client.state().references == {"position [V]": pytest.approx(1.0)})
    found = client.state()
    assert found.live
    assert found.outputs == {"position [V]": pytest.approx(1.0, abs=0.2)}
    assert -10.0 <= found.inputs["drive [V]"] <= 10.0
    assert found.standstill == ""
    for ask in (client.say, client.check):
        assert "of 1 V asked, from -8 to 8; drive" in call(ask, "where is the beam?").line
    loop.plant.deactivate()  # alone: in lockstep a loop never rests
    checked = call(client.check, "go up by 1 V")
    assert checked.line.startswith("position from 1 V (1.3 deg) to 2 V (2.6 deg)")
    assert checked.forecast.loop.outputs[0, 0] / VOLT == pytest.approx(1.0, abs=0.2)
    assert not call(client.check, "hold 300 V").accepted
    assert len(loop.set_points) == 1
    dropped = call.pool.submit(client.say, "swing between -1 and 1 V at 0.5 Hz for 100 s")
    loop.bench.until(lambda: loop.commander.checking)
    assert call(client.say, "emergency stop").line.startswith("stopped: the inputs go to rest")
    loop.bench.until(dropped.done)
    assert dropped.result().line.startswith("dropped by a stop: the inputs go")
    assert call(client.stop).accepted
    monkeypatch.setattr(command_client, "LIVE", 0.0)
    with pytest.raises(UserError, match="no estimate has come for"):
        client.state()
    client.close()


def test_whoever_says_stop_stops_a_loop_without_a_commander(bench: Bench, context: Context) -> None:
    controller = bench.start(ControllerNode, policy="exact", lockstep=True, latency=0.0)
    call = Caller(bench)
    client = call(CommandClient, controller.rig, context=context, stops=True)
    assert call(client.say, "stop it now").line.startswith("stopped")
    assert controller.operation.mode is ControllerMode.STOP
    client.close()


def test_a_client_tells_the_inputs_where_the_estimates_have_fewer_states_than_the_rig(
    domain: int, context: Context
) -> None:
    """As a model has that leaves an actuator's dynamics out."""
    bench = Bench(domain, "winged_cone")
    commander = bench.start(CommanderNode, rig="winged_cone")
    client = Caller(bench)(CommandClient, commander.rig, context=context)
    outputs = [item.name for item in commander.rig.system.outputs]
    estimates, commands = bench.speak("state_estimate"), bench.speak("joint_command")
    references = bench.speak("reference", JointTrajectory)
    points = [JointTrajectoryPoint(positions=[0.0] * len(outputs))]

    def inputs() -> list[float]:
        estimates.publish(joint(1, name=outputs, position=[2.0] * len(outputs)))
        commands.publish(joint(1, name=["throttle", "elevator"], effort=[0.3, -0.1]))
        references.publish(JointTrajectory(joint_names=outputs, points=points))
        with suppress(UserError):  # some have not come yet
            return list(client.state().inputs.values())
        return []

    bench.until(lambda: inputs() == [0.3, -0.1])
    client.close()
    bench.close()
