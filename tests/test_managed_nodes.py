"""Managed nodes: their states, what they keep to while they change, and parameters that change while they run."""

from __future__ import annotations

import gc
import json
import math
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from hybrid_sysid_ros.nodes import managed, middleware
from hybrid_sysid_ros.nodes.composed import compose
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.operation import ControllerMode
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from tests.manager import ACTIVATE, CLEANUP, CONFIGURE, DEACTIVATE, change, set_parameter, state
from tests.node_bench import VOLT, Bench, ask
from tests.wheel import Wheel

MEMORY = 2.0
"""MB by which seventy nodes may grow a process."""


def topics(node: Any) -> set[str]:
    """What a node publishes that is the rig's."""
    found = node.get_publisher_names_and_types_by_node(node.get_name(), node.get_namespace())
    return {name.rsplit("/", 1)[1] for name, _ in found} & {"joint_states", "joint_command", "reference"}


def test_a_manager_leads_a_node_through_its_states(bench: Bench) -> None:
    node = bench.start(PlantNode, autostart=False, wait_for_readers=0)
    assert state(bench, "plant") == "unconfigured"
    assert not change(bench, "plant", ACTIVATE)
    assert change(bench, "plant", CONFIGURE)
    assert (state(bench, "plant"), topics(node)) == ("inactive", set())
    heard = bench.listen("joint_states")
    assert change(bench, "plant", ACTIVATE)
    bench.until(lambda: len(heard) > 5)
    assert topics(node) == {"joint_states"}
    assert change(bench, "plant", DEACTIVATE)
    last = node.plant.time
    count = len(heard)
    assert topics(node) == set()
    assert change(bench, "plant", ACTIVATE)
    bench.until(lambda: len(heard) > count + 5)
    assert node.plant.time > last  # the rig goes on from where it was
    assert change(bench, "plant", DEACTIVATE)
    assert change(bench, "plant", CLEANUP)
    assert state(bench, "plant") == "unconfigured"


def test_what_is_in_the_way_of_a_configuration_is_reported_and_can_be_mended(bench: Bench, model_folder: Path) -> None:
    said = bench.listen("/diagnostics", DiagnosticArray)
    bench.start(EstimatorNode, autostart=False, model="/nowhere")
    assert not change(bench, "estimator", CONFIGURE)
    assert state(bench, "estimator") == "unconfigured"

    def reported() -> Any:
        return [status for message in said for status in message.status if "/nowhere" in status.message]

    assert bench.until(reported)[0].level == DiagnosticStatus.ERROR
    assert set_parameter(bench, "estimator", "model", str(model_folder)) == ""
    assert change(bench, "estimator", CONFIGURE)
    assert "is read when the node is configured" in set_parameter(bench, "estimator", "rate", 100.0)


def test_a_stop_brings_the_input_to_rest_without_a_jump_and_keeps_it_there(
    bench: Bench, model_folder: Path, policy_folder: Path
) -> None:
    wheel = Wheel(bench, model_folder, policy_folder, lockstep=True, stop_seconds=0.2)
    wheel.refer([VOLT] * 9)
    before = wheel.command(0.0)
    assert before == pytest.approx(4.0)
    assert ask(bench, Trigger, "controller/stop", Trigger.Request()).success
    actuator = load_rig("cam_beam").actuators[0]
    largest = (actuator.high - actuator.low) / (0.2 * 200)  # in one of the 200 periods of a second
    inputs = [before] + [wheel.command(0.0) for _ in range(12)]
    steps = [one - other for one, other in pairwise(inputs)]
    assert max(steps) == pytest.approx(largest)
    assert min(steps) >= 0.0
    assert inputs[-1] == 0.0
    assert wheel.command(math.nan) == 0.0
    assert wheel.command(0.0, step=2 * SECOND) == 0.0
    assert ask(bench, Trigger, "controller/enable", Trigger.Request()).success
    back = [wheel.command(0.0) for _ in range(40)]
    assert 0.0 < back[0] < back[-1] == pytest.approx(4.0)


def test_the_outputs_are_held_where_they_are(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 9)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert ask(wheel.bench, Trigger, "controller/hold", Trigger.Request()).success
    assert wheel.command(3 * VOLT) == pytest.approx(wheel.command(3 * VOLT))
    assert wheel.controller.home[0] == pytest.approx(3 * VOLT)


@pytest.fixture
def wheel(bench: Bench, model_folder: Path, policy_folder: Path) -> Wheel:
    return Wheel(bench, model_folder, policy_folder, lockstep=True)


def test_a_controller_that_is_deactivated_leaves_the_input_at_rest(wheel: Wheel) -> None:
    wheel.refer([VOLT] * 9)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert change(wheel.bench, "controller", DEACTIVATE)
    assert wheel.bench.until(lambda: wheel.commands[-1].effort[0] == 0.0)
    assert wheel.controller.operation.mode is ControllerMode.STOP
    assert topics(wheel.controller) == set()


def test_nodes_are_composed_of_their_names(bench: Bench, domain: int) -> None:
    import rclpy

    rclpy.init(domain_id=domain)
    try:
        made = compose(["--nodes", "plant", "reference", "--namespaces", "left", "right"])
        assert [node.get_fully_qualified_name() for node in made] == [
            "/left/plant",
            "/left/reference",
            "/right/plant",
            "/right/reference",
        ]
        for node in made:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_what_nobody_has_foreseen_is_refused_and_the_services_go_on(
    wheel: Wheel, monkeypatch: pytest.MonkeyPatch
) -> None:
    wheel.refer([VOLT] * 9)
    assert wheel.command(0.0) == pytest.approx(4.0)
    assert "too long" in set_parameter(wheel.bench, "controller", "model", 300 * "x")
    monkeypatch.setattr(wheel.controller, "adapter_of", lambda settings: 1 / 0)
    assert "ZeroDivisionError" in set_parameter(wheel.bench, "controller", "policy", "exact")
    assert wheel.command(VOLT) == pytest.approx(1.0)
    assert ask(wheel.bench, Trigger, "controller/stop", Trigger.Request()).success


SLOW = """
import sys, time
from hybrid_sysid_ros.nodes import controller, process

def make():
    node = controller.ControllerNode()
    node.adapter_of = lambda settings: time.sleep(60.0)
    return node

sys.exit(process.run(make))
"""


def test_a_stop_does_not_wait_for_what_is_being_loaded(domain: int, model_folder: Path, policy_folder: Path) -> None:
    """A model on a disk that does not answer."""
    given = [f"model:={model_folder}", f"policy_path:={policy_folder}", "policy:=network", "certificate:=ignore"]
    words = [word for item in given for word in ("-p", item)]
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW, "--ros-args", "-r", "__ns:=/cam_beam", *words],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
    )
    bench = Bench(domain)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        stop = bench.probe.create_client(Trigger, "controller/stop")
        client = bench.probe.create_client(SetParameters, "controller/set_parameters")
        bench.until(lambda: stop.service_is_ready() and client.service_is_ready())
        asked: list[Any] = []

        def answered() -> bool:
            """Between processes the way back of the first answers may not be there yet."""
            asked.append(stop.call_async(Trigger.Request()))
            return any(call.done() for call in asked)

        bench.until(answered)
        other = Parameter("model", value=str(model_folder)).to_parameter_msg()
        loading = client.call_async(SetParameters.Request(parameters=[other]))
        for _ in range(3):
            call = stop.call_async(Trigger.Request())
            bench.until(call.done)
            assert call.result().success
        assert not loading.done()
    finally:
        process.kill()
        process.communicate()
        bench.close()


def test_a_node_that_is_not_active_says_so(bench: Bench) -> None:
    bench.start(PlantNode, autostart=False)
    answer = ask(bench, Trigger, "plant/reset", Trigger.Request())
    assert (answer.success, answer.message) == (False, "the node is unconfigured: its part of the loop is at rest")


def test_the_rig_is_put_back_again_and_again(bench: Bench) -> None:
    node = bench.start(PlantNode, wait_for_readers=0)
    for _ in range(5):
        before = node.plant
        assert ask(bench, Trigger, "plant/reset", Trigger.Request()).success
        bench.until(lambda before=before: node.plant is not before and node.started)  # type: ignore[misc]


def test_a_node_that_cannot_be_made_is_gone_at_once(bench: Bench) -> None:
    """Its services would be found by others until Python's collector comes."""
    with pytest.raises(UserError, match="/nowhere") as error:
        bench.start(ControllerNode, policy="exact", model="/nowhere")
    assert error.tb is not None  # its frames hold the node
    assert "controller" not in bench.probe.get_node_names()


def taken() -> tuple[int, int, float]:
    """Threads and files of this process, and its memory [MB]."""
    gc.collect()
    status = Path("/proc/self/status").read_text(encoding="ascii")
    resident = next(float(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
    return len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd")), resident / 1024


def a_hundred_nodes() -> None:
    """Make one after the other, each through its states twice, and print what is taken after thirty and after all."""
    middleware.prepare_middleware()
    context = Context()
    rclpy.init(context=context)
    executor = SingleThreadedExecutor(context=context)
    for k in range(50):
        for kind in (PlantNode, ReferenceNode):
            node = kind(context=context, parameter_overrides=[Parameter("lockstep", value=True)])
            for step in ("deactivate", "cleanup", "configure", "activate"):
                assert getattr(node, f"trigger_{step}")() == TransitionCallbackReturn.SUCCESS
            executor.add_node(node)
            executor.spin_once(timeout_sec=0.0)
            executor.remove_node(node)
            node.destroy_node()
        if k in (15, 49):
            print(json.dumps(taken()))
    executor.shutdown()
    context.try_shutdown()


@pytest.mark.slow
def test_a_hundred_nodes_one_after_the_other_leave_nothing_behind(domain: int) -> None:
    """In a process of their own: beside another node the middleware keeps some 100 kB of every node, also of one that
    rclpy alone makes, and what earlier tests left in this process moves its memory by more than that.
    """
    code = "from tests.test_managed_nodes import a_hundred_nodes; a_hundred_nodes()"
    root = Path(__file__).parents[1]
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=root)
    settled, last = map(json.loads, found.stdout.splitlines()[-2:])
    assert last[0] <= settled[0]  # threads
    assert last[1] <= settled[1]  # files
    assert last[2] < settled[2] + MEMORY


def test_a_loop_that_does_not_get_to_a_service_in_time_is_reported_and_does_nothing_later(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(managed, "PATIENCE", 0.05)
    done: list[int] = []
    monkeypatch.setattr(EstimatorNode, "own_services", lambda node: {"reset": lambda: done.append(1)})
    node = bench.start(EstimatorNode)
    node.thread = -1  # a loop that never turns
    answer = ask(bench, Trigger, "estimator/reset", Trigger.Request())
    assert not answer.success
    assert "did not get to it after 0.05 s" in answer.message
    node.thread = None
    bench.executor.spin_once(timeout_sec=0.05)
    assert not done
    assert ask(bench, Trigger, "estimator/reset", Trigger.Request()).success
    assert done


def test_an_error_without_words_is_reported_by_its_name(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise TimeoutError

    monkeypatch.setattr(EstimatorNode, "own_services", lambda node: {"reset": fail})
    bench.start(EstimatorNode)
    assert "TimeoutError" in ask(bench, Trigger, "estimator/reset", Trigger.Request()).message
