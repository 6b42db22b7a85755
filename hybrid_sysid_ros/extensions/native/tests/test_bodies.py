"""The loop in both bodies: what holds of the Python nodes estimator and controller holds of the native process."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.extensions.export import compiler
from hybrid_sysid_ros.extensions.native.build import native_loop
from hybrid_sysid_ros.extensions.native.rig_parameters import NODES
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.configuration import settings
from tests.node_bench import PATIENCE, VOLT, Bench, ask, joint, stamp_of

BODIES = ("python", "native")
Fault = Callable[[float], float]
PERIOD = 0.005
AGAIN = 1.0  # s, after which a measurement without an answer comes again
GIVEN: dict[str, dict[str, Any]] = {"estimator": {}, "controller": {"policy": "exact", "real_time": True}}
RIG = load("cam_beam")
pytestmark = pytest.mark.skipif(compiler.found() is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def binary() -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")  # compiles in a third of the time
        every = {node: settings(RIG, node, given)[0] or {} for node, given in GIVEN.items()}
        yield native_loop(RIG, every, tell=lambda line: None)


class LoopBody:
    """Estimator and controller in one of the bodies, and a probe that is their plant and their reference."""

    def __init__(
        self, kind: str, bench: Bench, domain: int, binary: Path, *, measurements: Any = None, **given: Any
    ) -> None:
        self.kind, self.bench, self.process = kind, bench, None
        self.plant, self.applied, self.periods = Plant(RIG, seed=1), 0.0, 0
        self.commands, self.estimates = bench.listen("joint_command"), bench.listen("state_estimate")
        self.measurements = measurements or bench.speak("joint_states")
        self.references = bench.speak("reference", JointTrajectory)
        if kind == "python":
            bench.start(EstimatorNode, **{name: given[name] for name in given if name != "armed"})
            bench.start(ControllerNode, **GIVEN["controller"], **given)
        else:
            words = [word for name, value in given.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
            self.process = subprocess.Popen(
                [binary, "--ros-args", "-r", f"__ns:=/{bench.namespace}", *words],
                env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
        own = bench.probe
        bench.until(lambda: own.count_publishers("joint_command") and own.count_publishers("state_estimate"))
        bench.until(lambda: self.measurements.get_subscription_count() and self.references.get_subscription_count())

    def close(self) -> None:
        """End the process in order, and wait until its readers have gone: the middleware once crashed where the probe
        was destroyed right behind a partner that was killed.
        """
        if self.process is not None:
            self.process.terminate()
            _, complaint = self.process.communicate(timeout=PATIENCE)
            assert self.process.returncode == 0, complaint
            outlets = self.measurements, self.references
            self.bench.until(lambda: not any(outlet.get_subscription_count() for outlet in outlets))

    def ask(self, name: str, node: str = "controller") -> Any:
        return ask(self.bench, Trigger, f"{node}/{name}", Trigger.Request())

    def change(self, transition: int, node: str = "controller") -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(ask(self.bench, ChangeState, f"{node}/change_state", request).success)

    def set(self, name: str, value: Any) -> Any:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return ask(self.bench, SetParameters, "controller/set_parameters", request).results[0]

    def refer(self, stamp: int, level: float) -> None:
        message = JointTrajectory(joint_names=["beam"])
        set_nanoseconds(message.header.stamp, stamp)
        for seconds in (0, 3000):
            point = JointTrajectoryPoint(positions=[level])
            set_nanoseconds(point.time_from_start, seconds * SECOND)
            message.points.append(point)
        self.references.publish(message)

    def measure(self, stamp: int, angle: float, applied: float = 0.0) -> None:
        self.measurements.publish(joint(stamp, position=[angle], effort=[applied]))

    def go(self, periods: int, *, sensor: Fault = float, actuator: Fault = float) -> list[float]:
        """The commands of some periods of the simulated rig, in lockstep; sensor, actuator: what they make of it."""
        inputs = []
        for _ in range(periods):
            stamp = SECOND + round(self.periods * PERIOD * SECOND)
            reading = sensor(float(self.plant.sensed()[0]))
            inputs.append(self.answered(stamp, reading, self.applied).effort[0])
            self.applied = actuator(inputs[-1])
            self.periods += 1
            for _ in range(round(PERIOD / self.plant.step)):
                self.plant.advance([self.applied])
        return inputs

    def answered(self, stamp: int, angle: float = 0.0, applied: float = 0.0) -> JointState:
        """The command for a measurement, which comes again as from a plant in lockstep."""
        asked = -math.inf

        def found() -> list[JointState]:
            nonlocal asked
            if monotonic() - asked > AGAIN:
                asked = monotonic()
                self.measure(stamp, angle, applied)
            return [item for item in self.commands[-3:] if stamp_of(item) == stamp]

        found_once: list[JointState] = self.bench.until(found)
        return found_once[0]


@pytest.fixture(params=BODIES)
def body(request: pytest.FixtureRequest, bench: Bench, domain: int, binary: Path) -> Iterator[LoopBody]:
    made = LoopBody(request.param, bench, domain, binary, lockstep=True)
    yield made
    made.close()


@pytest.fixture(params=BODIES)
def timed(request: pytest.FixtureRequest, bench: Bench, domain: int, binary: Path) -> Iterator[LoopBody]:
    """In real time."""
    made = LoopBody(request.param, bench, domain, binary, zero_after=0.4, stale_after=0.3, stop_seconds=0.0)
    yield made
    made.close()


ANSWERS: dict[str, Any] = {}
FAULTS: dict[str, tuple[dict[str, Fault], str]] = {
    "a flipped sensor": ({"sensor": lambda angle: -angle}, "measurements contradict the model"),
    "a sensor without a number": ({"sensor": lambda angle: math.nan}, "there is no sound estimate"),
    "a disconnected actuator": ({"actuator": lambda volt: 0.0}, ""),  # which is tried again
    "a flipped actuator": ({"actuator": lambda volt: -volt}, "the actuator does not do what was commanded"),
}
RESTED: dict[str, dict[str, list[float]]] = {}
TRIED = 0.25  # V, with which an actuator in doubt is tried again


def test_the_bodies_answer_alike(body: LoopBody) -> None:
    body.refer(SECOND, 2.0 * VOLT)
    inputs = body.go(60)
    estimate = body.bench.until(lambda: body.estimates)[-1]
    ANSWERS[body.kind] = np.array(inputs), list(estimate.name), list(body.commands[-1].name)
    assert max(inputs) > 1.0
    if len(ANSWERS) == len(BODIES):
        (python, *names), (native, *others) = ANSWERS["python"], ANSWERS["native"]
        assert names == others
        np.testing.assert_allclose(native, python, atol=1e-6)


def test_both_bodies_rest_where_they_are_lied_to(body: LoopBody) -> None:
    reports, found = body.bench.listen("/diagnostics", DiagnosticArray), RESTED.setdefault(body.kind, {})

    def is_told(words: str) -> bool:
        own = [item for message in reports for item in message.status if item.name.endswith("controller: loop")]
        values = {item.key: item.value for item in own[-1].values} if own else {}
        return values.get("state") == "resting" and words in values["state_reason"]

    body.refer(SECOND, 2.0 * VOLT)
    for name, (fault, words) in FAULTS.items():
        body.go(200)
        found[name] = body.go(100, **fault)
        assert min(map(abs, found[name])) <= TRIED, name
        reports.clear()
        if words:
            body.bench.until(partial(is_told, words))
    assert max(body.go(200)) > 1.0, "it comes back"
    if len(RESTED) == len(BODIES):
        for name in FAULTS:
            np.testing.assert_allclose(RESTED["native"][name], RESTED["python"][name], atol=1e-6)


def test_no_measurement_leads_to_a_command_out_of_bounds(body: LoopBody) -> None:
    body.refer(SECOND, VOLT)
    wild = [math.nan, math.inf, -math.inf, 1e300, -1e300, 0.1, 1e6]
    for k, value in enumerate(wild):
        body.measurements.publish(joint(SECOND + k, name=["other"], position=[value]))
        body.measurements.publish(JointState(name=["beam"] * 3, position=[value]))
        body.measurements.publish(joint(SECOND, name=[f"x{j}" for j in range(20_000)]))
        body.measure(SECOND + round(k * PERIOD * SECOND), value, value)
    body.answered(SECOND + round(0.2 * SECOND))
    low, high = RIG.limits
    for command in body.commands:
        assert low[0] <= command.effort[0] <= high[0]


def test_the_services_stop_hold_and_free_the_loop(body: LoopBody) -> None:
    body.refer(SECOND, 2.0 * VOLT)
    assert body.go(3)[-1] != 0.0
    assert body.ask("stop").success
    assert body.go(80)[-1] == 0.0
    refused = body.ask("hold")
    assert not refused.success
    assert "stopped" in refused.message
    assert body.ask("enable").success
    assert max(body.go(60)) > 0.0
    assert body.ask("estop").success
    assert body.go(1) == [0.0]
    refused = body.ask("enable")
    assert not refused.success
    assert "call the services reset and arm" in refused.message
    assert "latched" in body.ask("arm").message
    assert body.ask("reset").success
    body.refer(SECOND, 2.0 * VOLT)
    assert body.go(1) == [0.0]
    assert body.ask("arm").success
    assert max(body.go(60)) > 0.0
    assert body.ask("reset", "estimator").success


def test_inputs_rest_when_measurements_stop(timed: LoopBody) -> None:
    now = timed.bench.probe.get_clock().now().nanoseconds
    timed.refer(now, 5.0 * VOLT)
    timed.bench.until(lambda: _drive(timed).effort[0] != 0.0)
    timed.bench.until(lambda: timed.commands[-1].effort[0] == 0.0)


def _drive(body: LoopBody) -> JointState:
    now = body.bench.probe.get_clock().now().nanoseconds
    return body.answered(now)


def test_a_driver_may_offer_best_effort(bench: Bench, domain: int, binary: Path) -> None:
    driver = bench.probe.create_publisher(JointState, "joint_states", qos_profile_sensor_data)
    body = LoopBody("native", bench, domain, binary, measurements=driver, lockstep=True)
    body.refer(SECOND, VOLT)
    assert body.go(3)[-1] != 0.0
    body.close()


def test_a_manager_changes_the_states(timed: LoopBody) -> None:
    assert ask(timed.bench, GetState, "controller/get_state", GetState.Request()).current_state.label == "active"
    assert not timed.change(Transition.TRANSITION_CONFIGURE)
    timed.refer(timed.bench.probe.get_clock().now().nanoseconds, 5.0 * VOLT)
    timed.bench.until(lambda: _drive(timed).effort[0] != 0.0)
    assert timed.change(Transition.TRANSITION_DEACTIVATE)
    timed.bench.until(lambda: timed.commands[-1].effort[0] == 0.0)
    assert "at rest" in timed.ask("enable").message
    assert timed.change(Transition.TRANSITION_CLEANUP)
    assert timed.change(Transition.TRANSITION_CONFIGURE)
    assert timed.change(Transition.TRANSITION_ACTIVATE)
    timed.bench.until(lambda: timed.bench.probe.count_publishers("joint_command"))


def test_parameters_are_told_set_and_refused(body: LoopBody) -> None:
    known = ask(body.bench, ListParameters, "controller/list_parameters", ListParameters.Request()).result.names
    assert {"rig", "zero_after", "output_weight", "use_sim_time"} <= {*known}
    assert body.set("zero_after", 0.7).successful
    found = ask(body.bench, GetParameters, "controller/get_parameters", GetParameters.Request(names=["zero_after"]))
    assert found.values[0].double_value == 0.7
    for name, value in (("zero_after", 0.01), ("zero_after", 2.0e6), ("horizon", 7), ("zero_after", "long")):
        refused = body.set(name, value)
        assert not refused.successful
        assert refused.reason


def test_what_the_native_loop_says_of_itself(bench: Bench, domain: int, binary: Path) -> None:
    reports = bench.listen("/diagnostics", DiagnosticArray)
    body = LoopBody("native", bench, domain, binary, lockstep=True)
    found = bench.until(lambda: {item.name for message in reports for item in message.status})
    bench.until(lambda: len({item.name for message in reports for item in message.status}) == 5)
    assert all(name.startswith(("cam_beam/estimator: ", "cam_beam/controller: ")) for name in found)
    assert body.process is not None
    body.process.send_signal(signal.SIGTERM)
    said, complaint = body.process.communicate(timeout=20.0)
    assert body.process.returncode == 0, complaint
    words = said.splitlines()
    assert words[0] == "ready"
    assert {json.loads(line)["node"] for line in words[1:]} == {*NODES}
    refused = subprocess.run([binary, "--ros-args", "-p", "horizon:=7"], capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert refused.stderr.startswith("error: parameter horizon is a part of the compiled loop")
