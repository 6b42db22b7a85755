"""The view node: what a page gets is what was published, and what a page asks for arrives where it should."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Iterator
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
pytest.importorskip("websockets", reason="needs websockets: install hybrid_sysid_ros[view]")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from websockets.sync.client import ClientConnection, connect

from hybrid_sysid_ros.extensions.view.nodes.view import ViewNode
from hybrid_sysid_ros.extensions.view.tables import unpacked
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from tests.node_bench import VOLT, Bench, joint

PERIOD = SECOND // 200
START = 7 * SECOND
PATIENCE = 10.0  # s


@pytest.fixture
def view(bench: Bench) -> Iterator[ViewNode]:
    node: ViewNode = bench.start(ViewNode, port=0, pictures=60.0)
    yield node
    node.deactivate()


@pytest.fixture
def page(view: ViewNode) -> Iterator[ClientConnection]:
    server = view.server
    address = f"ws://127.0.0.1:{server.port}/live?token={server.token}"
    with connect(address, origin=f"http://127.0.0.1:{server.port}") as made:  # type: ignore[arg-type]
        assert json.loads(made.recv(timeout=PATIENCE))["rig"] == "cam_beam"
        yield made


class Seen:
    """All that the frames of a page have brought."""

    def __init__(self, page: ClientConnection) -> None:
        self.page = page
        self.rows: dict[str, list[list[float]]] = {}
        self.latest: dict[str, Any] = {}
        self.news: dict[str, Any] = {}

    def look(self) -> Seen:
        self.page.send('{"do": "next"}')
        data = self.page.recv(timeout=PATIENCE)
        assert isinstance(data, bytes)
        head, arrays = unpacked(data)
        for name, rows, _ in head["tables"]:
            assert len(arrays[name]) == rows
            self.rows.setdefault(name, []).extend(arrays[name].tolist())
        self.latest |= {name: arrays[name] for name, _, _ in head["latest"]}
        self.news |= head["news"]
        return self

    def until(self, condition: Callable[[Seen], Any]) -> Seen:
        end = perf_counter() + PATIENCE
        while not condition(self.look()):
            assert perf_counter() < end, "waited in vain"
        return self

    def table(self, name: str) -> np.ndarray[Any, Any]:
        return np.array(self.rows[name])


def ask(bench: Bench, page: ClientConnection, **request: Any) -> dict[str, Any]:
    """The answer to a request, while the nodes go on."""
    found: list[dict[str, Any]] = []

    def wait() -> None:
        page.send(json.dumps({"id": 1, **request}))
        found.append(json.loads(page.recv(timeout=PATIENCE)))

    thread = threading.Thread(target=wait)
    thread.start()
    bench.until(lambda: found)
    thread.join()
    return found[0]


def test_a_page_gets_what_was_published(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    measurements, estimates, commands = (
        bench.speak(topic) for topic in ("joint_states", "state_estimate", "joint_command")
    )
    bench.until(lambda: all(one.get_subscription_count() for one in (measurements, estimates, commands)))
    seen, k = Seen(page), np.arange(50)
    position, applied, estimated = 0.01 * np.sin(k), 0.1 * k, 0.01 * np.cos(k)
    for i in range(50):
        stamp = START + i * PERIOD
        measurements.publish(joint(stamp, position=[position[i]], effort=[applied[i]]))
        estimates.publish(
            joint(
                stamp, name=("beam", "beam_ahead"), position=[estimated[i], 9.0], velocity=[1.0, 9.0], effort=[0.2, 9.0]
            )
        )
        commands.publish(joint(stamp, effort=[-applied[i]]))
    seen.until(lambda it: all(len(it.rows.get(name, ())) == 50 for name in ("measured", "estimate", "command")))
    times = k * PERIOD / SECOND
    np.testing.assert_allclose(
        seen.table("measured"), np.column_stack([times, position / VOLT, applied]), rtol=1e-12, atol=1e-12
    )
    disturbance = np.full(50, 0.2)
    np.testing.assert_allclose(
        seen.table("estimate"), np.column_stack([times, estimated / VOLT, disturbance, estimated]), atol=1e-12
    )
    command = seen.table("command")
    np.testing.assert_allclose(command[:, :2], np.column_stack([times, -applied]), atol=1e-12)
    assert (command[:, 2] > 0.0).all()  # ms, from one publication to the other
    assert (command[:, 2] < 1e3).all()


def test_a_page_gets_previews_plans_and_diagnostics(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    measurements, references = bench.speak("joint_states"), bench.speak("reference", JointTrajectory)
    plans, reports = bench.speak("predicted_trajectory", JointTrajectory), bench.speak("/diagnostics", DiagnosticArray)
    bench.until(lambda: all(one.get_subscription_count() for one in (measurements, references, plans, reports)))
    measurements.publish(joint(START, position=[0.0], effort=[0.0]))
    seen = Seen(page).until(lambda it: it.rows)
    message = JointTrajectory(joint_names=["beam"])
    set_nanoseconds(message.header.stamp, START)
    for k in range(3):
        point = JointTrajectoryPoint(positions=[k * VOLT], velocities=[0.0], effort=[0.5 * k])
        set_nanoseconds(point.time_from_start, k * SECOND // 10)
        message.points.append(point)
    references.publish(message)
    plans.publish(message)
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN,
        name="cam_beam/plant: loop",
        message="late",
        hardware_id="cam_beam",
        values=[KeyValue(key="commands", value="7")],
    )
    other = DiagnosticStatus(name="elsewhere: disk", hardware_id="another")
    reports.publish(DiagnosticArray(status=[status, other]))
    seen.until(lambda it: {"reference", "prediction"} <= it.latest.keys() and "status cam_beam/plant: loop" in it.news)
    np.testing.assert_allclose(seen.latest["reference"], [[0.0, 0.0], [0.1, 1.0], [0.2, 2.0]], atol=1e-9)
    set_nanoseconds(message.header.stamp, START + SECOND * 15 // 100)
    references.publish(message)
    seen.until(lambda it: "asked" in it.rows)
    np.testing.assert_allclose(seen.table("asked"), [[0.0, 0.0], [0.1, 1.0]], atol=1e-9)  # until the next one begins
    np.testing.assert_allclose(
        seen.latest["prediction"], [[0.0, 0.0, 0.0], [0.1, 1.0, 0.5], [0.2, 2.0, 1.0]], atol=1e-9
    )
    (found,) = [value for name, value in seen.news.items() if name.startswith("status ")]
    assert found["line"] == "late"
    assert (found["node"], found["task"], found["level"], found["values"]) == ("plant", "loop", 1, {"commands": "7"})


def test_nonsense_on_the_topics_is_not_shown(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    measurements = bench.speak("joint_states")
    bench.until(measurements.get_subscription_count)
    for position in ([math.nan], [math.inf], [1e300], [], [0.1, 0.2]):
        measurements.publish(joint(START, position=position, effort=[0.0]))
    measurements.publish(joint(START, name=("other",), position=[0.1]))
    measurements.publish(joint(START, position=[VOLT], effort=[0.0]))
    seen = Seen(page).until(lambda it: it.rows and it.rows["measured"][-1][1] == pytest.approx(1.0))
    assert np.isnan(seen.table("measured")[:-1, 1]).all()


def test_a_set_point_is_the_reference_at_once(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    reference = bench.start(ReferenceNode, kind="constant", amplitude=0.0)
    measurements, heard = bench.speak("joint_states"), bench.listen("reference", JointTrajectory)
    bench.until(lambda: measurements.get_subscription_count() >= 2 and view.set_points.get_subscription_count())
    measurements.publish(joint(bench.probe.get_clock().now().nanoseconds, position=[0.0], effort=[0.0]))
    bench.until(lambda: heard)
    for k in range(1, 6):
        page.send(json.dumps({"do": "set_point", "times": [0.0], "values": [[0.1 * k]]}))
        wanted = pytest.approx(0.1 * k * VOLT)
        bench.until(lambda wanted=wanted: heard[-1].points[-1].positions[0] == wanted)  # type: ignore[misc]
        assert json.loads(page.recv(timeout=PATIENCE))["done"]
    assert reference.health()[0].values["kind"] == "set_point"


def test_a_drawn_curve_is_followed_point_by_point(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    bench.start(ReferenceNode, kind="constant", amplitude=0.0, lockstep=True)
    measurements, heard = bench.speak("joint_states"), bench.listen("reference", JointTrajectory)
    bench.until(lambda: measurements.get_subscription_count() >= 2 and view.set_points.get_subscription_count())
    measurements.publish(joint(START, position=[0.0], effort=[0.0]))
    bench.until(lambda: heard)
    answer = ask(bench, page, do="set_point", times=[0.0, 0.1, 0.3], values=[[0.0], [2.0], [-2.0]])
    assert answer["done"]
    bench.until(lambda: len(heard) > 1)
    points = {
        point.time_from_start.sec + point.time_from_start.nanosec / SECOND: point.positions[0] / VOLT
        for point in heard[-1].points
    }
    times = sorted(points)
    wanted = np.interp(times, [0.0, 0.1, 0.3], [0.0, 2.0, -2.0])
    np.testing.assert_allclose([points[time] for time in times], wanted, atol=1e-6)


def test_experiments_and_faults_are_parameters_of_other_nodes(
    bench: Bench, view: ViewNode, page: ClientConnection
) -> None:
    reference = bench.start(ReferenceNode, kind="constant", amplitude=0.0)
    plant = bench.start(PlantNode, wait_for_readers=0)
    clients = view.setters.values()
    bench.until(lambda: sum(client.service_is_ready() for client in clients) == 2)
    assert ask(bench, page, do="experiment", kind="hardware")["done"]
    assert reference.settings["kind"] == "hardware"
    assert ask(bench, page, do="fault", name="brake", on=True)["done"]
    assert plant.settings["brake"] == [0.0, 25.0]
    assert ask(bench, page, do="fault", name="brake", on=False)["done"]
    assert plant.settings["brake"] == [0.0, 0.0]
    refused = ask(bench, page, do="policy", policy="exact")
    assert not refused["done"]
    assert "no controller is there" in refused["line"]


def test_a_page_knows_who_is_there_and_calls_them(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    called: list[str] = []

    def answer(name: str, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        called.append(name)
        response.success, response.message = name != "arm", f"{name} was called"
        return response

    for name in ("stop", "hold", "arm"):
        bench.probe.create_service(Trigger, f"controller/{name}", partial(answer, name))
    bench.until(lambda: sum(client.service_is_ready() for client in view.calls.values()) == 3)
    seen = Seen(page).until(lambda it: len(it.news.get("there", {}).get("services", ())) == 3)
    assert seen.news["there"] == {"services": ["stop", "hold", "arm"], "nodes": [], "set_points": False}
    assert ask(bench, page, do="call", service="hold") == {"answer": 1, "done": True, "line": "hold was called"}
    refused = ask(bench, page, do="call", service="arm")
    assert (refused["done"], refused["line"]) == (False, "controller: arm was called")
    assert "no controller is there" in ask(bench, page, do="call", service="estop")["line"]
    assert called == ["hold", "arm"]


def test_weights_are_shown_and_set_as_the_controller_has_them(
    bench: Bench, view: ViewNode, page: ClientConnection
) -> None:
    controller = bench.add(Node("controller", context=bench.context, namespace=bench.namespace))
    for name, value in (("output_weight", 100.0), ("rate_weight", 1.0), ("input_weight", 0.0)):
        controller.declare_parameter(name, [value])
    bench.until(lambda: view.weights.service_is_ready() and view.setters["controller"].service_is_ready())
    seen = Seen(page)
    bench.until(lambda: seen.look().news.get("weights"))
    assert seen.news["weights"] == {"output_weight": [100.0], "rate_weight": [1.0], "input_weight": [0.0]}
    assert ask(bench, page, do="weight", name="rate_weight", values=[2.5])["line"] == "rate_weight is 2.5"
    assert controller.get_parameter("rate_weight").value[0] == 2.5
    bench.until(lambda: seen.look().news["weights"]["rate_weight"] == [2.5])
    controller.set_parameters([Parameter("input_weight", value=[0.5])])  # by somebody else
    bench.until(lambda: seen.look().news["weights"]["input_weight"] == [0.5])


def test_a_page_knows_the_state_of_the_controller(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    reports = bench.speak("/diagnostics", DiagnosticArray)
    bench.until(reports.get_subscription_count)
    values = [KeyValue(key="state", value="slowed"), KeyValue(key="state_reason", value="the model is off")]
    status = DiagnosticStatus(name="cam_beam/controller: loop", hardware_id="cam_beam", values=values)
    reports.publish(DiagnosticArray(status=[status]))
    seen = Seen(page).until(lambda it: "controller" in it.news)
    assert seen.news["controller"] == {"state": "slowed", "reason": "the model is off"}
    view.history.heard -= 60.0  # s
    seen.until(lambda it: it.news["controller"]["state"] == "silent")


def test_without_a_reference_node_a_set_point_is_refused(bench: Bench, view: ViewNode, page: ClientConnection) -> None:
    answer = ask(bench, page, do="set_point", times=[0.0], values=[[0.0]])
    assert not answer["done"]
    assert "no reference node" in answer["line"]
