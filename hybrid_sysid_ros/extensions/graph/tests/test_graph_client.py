"""Running nodes asked from outside: what they do, have, are and send, and what is said where they are not there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

import rclpy
from rclpy.context import Context
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from hybrid_sysid_ros.extensions.graph.nodes import graph_client
from hybrid_sysid_ros.extensions.graph.nodes.graph_client import GraphClient
from hybrid_sysid_ros.extensions.shared.nodes.collector import Uncalled
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.support.errors import UserError
from tests.node_bench import Bench

Ask = Callable[..., Any]


@pytest.fixture
def ask(bench: Bench, domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ask]:
    """A question, put in a thread while the nodes of the bench run."""
    for name, seconds in (("THERE_TIMEOUT", 1.0), ("SETTLED", 0.3), ("REPORTED", 0.6)):
        monkeypatch.setattr(graph_client, name, seconds)
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    client = GraphClient(context)
    with ThreadPoolExecutor(1) as thread:

        def asked(question: str, **given: Any) -> Any:
            answer = thread.submit(getattr(client, question), **given)
            bench.until(answer.done)
            return answer.result()

        yield asked
    client.close()
    context.try_shutdown()


def test_every_node_of_a_rig_that_offers_a_service_is_called(bench: Bench, ask: Ask) -> None:
    plant = bench.start(PlantNode)
    bench.probe.create_client(Trigger, "controller/stop")  # which nobody offers
    assert ask("services") == ["/cam_beam/plant/enable", "/cam_beam/plant/reset"]
    assert ask("call", service="reset") == [{"service": "/cam_beam/plant/reset", "done": True, "message": ""}]
    assert ask("call", service="plant/reset", namespace="/cam_beam")[0]["done"]
    plant.trigger_deactivate()
    (answer,) = ask("call", service="/cam_beam/plant/reset")
    assert not answer["done"]
    assert "inactive" in answer["message"]


def test_of_two_rigs_neither_is_called_unless_it_is_named(bench: Bench, ask: Ask) -> None:
    bench.start(PlantNode)
    bench.namespace = "wheel"
    bench.start(PlantNode, rig="wheel_motor")
    with pytest.raises(UserError, match="/cam_beam, /wheel: give --rig"):
        ask("call", service="reset")
    with pytest.raises(UserError, match="/cam_beam/plant, /wheel/plant: give --rig"):
        ask("get", node="plant")
    assert [answer["service"] for answer in ask("call", service="/wheel/plant/reset")] == ["/wheel/plant/reset"]
    assert ask("get", node="plant", names=["rig"], namespace="/wheel")["parameters"][0]["value"] == "wheel_motor"


def test_parameters_are_read_and_set_as_the_node_takes_them(bench: Bench, ask: Ask) -> None:
    plant = bench.start(PlantNode)
    found = {item["name"]: item for item in ask("get", node="plant")["parameters"]}
    assert found["bias"]["value"] == plant.settings["bias"]
    assert "[V]" in found["bias"]["description"]
    assert "within [0, " in found["command_delay"]["description"]
    assert not any(name.startswith("qos") for name in found)
    assert ask("set", node="plant", values={"bias": "[1]", "sensor_out": "1"})["values"]["bias"] == [1.0]
    assert (plant.settings["bias"], plant.settings["sensor_out"]) == ([1.0], [1.0])
    with pytest.raises(UserError, match=r"/cam_beam/plant refuses bias, command_delay: .*command_delay.* -1"):
        ask("set", node="plant", values={"bias": "2", "command_delay": "-1"})
    assert plant.settings["bias"] == [1.0]
    for question in ({"names": ["bais"]}, {"values": {"bais": "1"}}):
        with pytest.raises(UserError, match=r"plant has no parameter bais: the nearest of .* are bias"):
            ask("set" if "values" in question else "get", node="plant", **question)
    with pytest.raises(UserError, match=r"bias=.*is no value"):
        ask("set", node="plant", values={"bias": "[1"})


def test_a_service_of_another_type_is_named_with_it(bench: Bench, ask: Ask) -> None:
    bench.start(ReferenceNode, autostart=False)
    with pytest.raises(UserError, match="is of type rcl_interfaces/srv/GetParameters, and only std_srvs/srv/Trigger"):
        ask("call", service="reference/get_parameters")


@pytest.mark.slow
def test_what_is_not_there_is_said_with_what_is(bench: Bench, ask: Ask, domain: int) -> None:
    nobody = f"in ROS domain {domain}, looked for 1 s: "
    bench.start(ReferenceNode, autostart=False)
    with pytest.raises(UserError, match=f"offers the service stop {nobody}start it with hybrid-sysid run"):
        ask("call", service="stop")
    with pytest.raises(UserError, match=f"no node plant {nobody}known are /cam_beam/probe, /cam_beam/reference"):
        ask("get", node="plant")


def test_a_node_that_does_not_answer_is_named(bench: Bench, ask: Ask) -> None:
    bench.start(ReferenceNode, autostart=False)
    bench.probe.create_service(Trigger, "probe/wait", lambda _, answer: answer, callback_group=Uncalled())
    with pytest.raises(UserError, match=r"/cam_beam/probe/wait does not answer within 0.3 s"):
        ask("call", service="wait", timeout=0.3)


def test_nodes_and_topics_are_listed_with_what_comes(bench: Bench, ask: Ask) -> None:
    bench.start(ReferenceNode, autostart=False)
    found = {item["node"]: item["tasks"] for item in ask("nodes")}
    assert found["/cam_beam/probe"] == []
    assert found["/cam_beam/reference"] == [{"task": "loop", "level": "WARN", "message": "unconfigured"}]
    publisher = bench.speak("spoken")
    bench.probe.create_timer(0.02, lambda: publisher.publish(JointState()))
    topics = {item["topic"]: item for item in ask("topics", seconds=1.0)}
    spoken = topics["/cam_beam/spoken"]
    assert (spoken["type"], spoken["publishers"]) == ("sensor_msgs/msg/JointState", 1)
    assert 5.0 < spoken["hz"] <= 55.0
    assert ask("topics")[0]["hz"] is None


def test_the_command_line_prints_what_a_node_answers(bench: Bench, domain: int) -> None:
    bench.start(ReferenceNode, autostart=False)
    words = [sys.executable, "-m", "hybrid_sysid_ros", "get", "reference", "autostart", "--json", "--domain", domain]
    client = subprocess.Popen(
        [*map(str, words)], stdout=subprocess.PIPE, text=True,
        env={**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
    )  # fmt: skip
    bench.until(lambda: client.poll() is not None)
    assert json.loads(client.communicate()[0]) == {"autostart": False}


def test_a_stop_does_not_wait_for_what_identifies() -> None:
    """SciPy's signal takes longer to load than all else of `call stop`."""
    code = "import sys, hybrid_sysid_ros.extensions.graph.commands.call; print('scipy.signal' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
