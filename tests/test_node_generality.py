"""The nodes on other rigs than the beam: several inputs, states that nothing measures, outputs that are no states."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.core import Recurrence
from hybrid_sysid_ros.identification import Part, identify
from hybrid_sysid_ros.models import Sampling, structure_names
from hybrid_sysid_ros.nodes.cdr import JointWriter
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.rigs import rig as rigs
from tests import two_carts
from tests.compiling import compiled_functions
from tests.node_bench import Bench, stamp_of
from tests.shared import exact_model

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def carts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_carts.write(tmp_path_factory.mktemp("rigs") / "two_carts")


class Lockstep:
    """Plant, estimator, exact MPC and reference of a rig, and what they say."""

    def __init__(self, bench: Bench, rig: Path | str, model: Path, **controller: Any) -> None:
        self.measurements = bench.listen("joint_states")
        self.estimates = bench.listen("state_estimate")
        self.commands = bench.listen("joint_command")
        self.references = bench.listen("reference", JointTrajectory)
        given = {"rig": str(rig), "model": str(model)}
        bench.start(ReferenceNode, rig=str(rig), lockstep=True)
        self.estimator: EstimatorNode = bench.start(EstimatorNode, **given, lockstep=True, latency=0.0)
        self.controller: ControllerNode = bench.start(
            ControllerNode, **given, lockstep=True, latency=0.0, **{"policy": "exact", **controller}
        )
        self.plant: PlantNode = bench.start(PlantNode, rig=str(rig), lockstep=True, wait_for_readers=3)
        self.bench = bench

    def run(self, turns: int) -> None:
        self.bench.until(lambda: len(self.commands) >= turns and len(self.measurements) >= turns)

    def column(self, messages: list[Any], field: str, entry: str) -> np.ndarray:
        return np.array([getattr(item, field)[list(item.name).index(entry)] for item in messages])


@pytest.mark.slow
def test_two_inputs_drive_two_outputs_to_their_references(domain: int, carts: Path, tmp_path: Path) -> None:
    model = tmp_path / "model"
    exact_model(rigs.load(carts)).save(model)
    bench = Bench(domain, namespace="two_carts")
    try:
        loop = Lockstep(bench, carts, model)
        loop.run(500)
    finally:
        bench.close()
    first = loop.measurements[0]
    assert list(first.name) == ["cart", "gap", "right_push"]
    left, gap = (loop.column(loop.measurements, "position", name) for name in ("cart", "gap"))
    seconds = np.array([stamp_of(item) for item in loop.measurements]) / SECOND - 1.0
    late, later = (seconds > 1.2) & (seconds < 1.4), seconds > 2.2
    np.testing.assert_allclose(left[late], 0.2, atol=0.003)
    np.testing.assert_allclose(gap[late], 0.0, atol=0.003)
    np.testing.assert_allclose(left[later], 0.2, atol=0.003)
    np.testing.assert_allclose(gap[later], 0.05, atol=0.003)
    pushes = np.stack([loop.column(loop.commands, "effort", name) for name in ("cart", "right_push")])
    assert np.isfinite(pushes).all()
    assert (pushes.min(axis=1) >= [-3.0, -4.0]).all()
    assert (pushes.max(axis=1) <= [5.0, 4.0]).all()
    # The state that nothing measures, and what the model does not know: the inputs' offsets.
    estimate = loop.estimates[-1]
    names = list(estimate.name)
    assert {"cart", "right", "right_speed", "gap", "right_push"} <= set(names)
    assert {f"{name}_ahead" for name in ("cart", "right", "right_speed", "right_push")} <= set(names)
    assert estimate.position[names.index("right")] == pytest.approx(0.25, abs=0.005)
    assert estimate.position[names.index("gap")] == pytest.approx(0.05, abs=0.003)
    assert estimate.effort[names.index("right_push_ahead")] == pytest.approx(-0.2, abs=0.05)
    points = loop.references[0].points
    assert loop.references[0].joint_names == ["cart", "gap"]
    assert all(len(point.positions) == 2 and not point.velocities for point in points)


@pytest.mark.slow
def test_the_flexible_joint_s_link_follows_speeds_in_lockstep(domain: int, tmp_path: Path) -> None:
    """Two outputs, a place and a speed; of five states one is a deflection that belongs to no joint."""
    model = tmp_path / "model"
    exact_model(rigs.load("flexible_joint")).save(model)
    bench = Bench(domain, namespace="flexible_joint")
    try:
        loop = Lockstep(bench, "flexible_joint", model)
        loop.run(500)
    finally:
        bench.close()
    rig = rigs.load("flexible_joint")
    assert list(loop.measurements[0].name) == ["motor", "link"]
    seconds = np.array([stamp_of(item) for item in loop.measurements]) / SECOND - 1.0
    wanted = rig.schedule()(seconds)[:, 1]
    speed = rig.display[1].shown(loop.column(loop.measurements, "velocity", "link"))
    settled = (seconds % 1.0 > 0.6) & (seconds % 1.0 < 0.8) & (seconds > 1.0)  # the next step is seen .2 s ahead
    assert np.abs(speed - wanted)[settled].mean() < 1.5  # rpm, of steps up to 30; the sensor's noise is .2
    torque = loop.column(loop.commands, "effort", "motor")
    assert np.abs(torque).max() <= 2.0
    names = list(loop.estimates[-1].name)
    hidden = [item.name for item in rig.system.states if item.name not in ("motor_angle", "link_angle")][2:]
    ahead = ["motor_ahead", "link_ahead", *(f"{name}_ahead" for name in hidden)]
    validity = ["doubt", "sensors_left_out", "input_reversed"]
    assert names == ["motor", "link", *hidden, *ahead, "motor_applied", *validity]
    point = loop.references[0].points[0]
    assert loop.references[0].joint_names == ["link"]
    assert (len(point.positions), len(point.velocities)) == (0, 1)


def test_ipopt_commands_what_the_compiled_solver_does(domain: int, carts: Path, tmp_path: Path) -> None:
    pytest.importorskip("hybrid_sysid_ros.extensions.ipopt")
    model = tmp_path / "model"
    exact_model(rigs.load(carts)).save(model)
    found = []
    for solver in ("sqp", "ipopt"):
        bench = Bench(domain, namespace="two_carts")
        try:
            loop = Lockstep(bench, carts, model, solver=solver)
            loop.run(4)
            found.append([list(message.effort) for message in loop.commands[:4]])
        finally:
            bench.close()
    np.testing.assert_allclose(found[0], found[1], atol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("structure", "own"), [("lugre", "deflection"), ("narx", "drive_1"), ("residual", "residual_position_1")]
)
def test_a_structure_with_states_of_its_own_drives_the_beam(
    domain: int, tmp_path: Path, structure: str, own: str
) -> None:
    if structure not in structure_names():
        pytest.skip("needs the extension narx")
    rig = rigs.load("cam_beam")
    record = bags.read(Path(__file__).parents[1] / "bags" / "beam_multisine", rig.signals)
    model = identify([record], rig, structure, sampling=Sampling(), part=Part(stop=0.3))
    model.save(tmp_path / "model")
    rate = 1.0 / model.system.period if isinstance(model.system, Recurrence) else 200.0
    bench = Bench(domain)
    try:
        measurements, commands = bench.listen("joint_states"), bench.listen("joint_command")
        estimates = bench.listen("state_estimate")
        given = {"model": str(tmp_path / "model"), "latency": 0.0}
        bench.start(ReferenceNode, lockstep=True, kind="constant", preview_seconds=2.0)
        bench.start(EstimatorNode, **given, lockstep=True, rate=rate)
        problem = {"period": 0.05, "substeps": 1 if rate < 200.0 else 10, "stale_after": 0.1}
        bench.start(ControllerNode, **given, **problem, lockstep=True, policy="exact")
        bench.start(PlantNode, lockstep=True, wait_for_readers=3, rate=rate)
        compiled = compiled_functions()
        turns = round(1.5 * rate)
        bench.until(lambda: len(measurements) > turns and len(commands) > turns)
        assert compiled_functions() == compiled  # the nodes were ready
    finally:
        bench.close()
    assert {own, f"{own}_ahead"} <= set(estimates[-1].name)
    reached = rig.display[0].shown([message.position[0] for message in measurements[-round(0.2 * rate) :]])
    if rate == 200.0:  # the sampled model is coarse
        assert np.mean(reached) == pytest.approx(4.0, abs=0.3)  # V, of the sensor
    assert max(abs(message.effort[0]) for message in commands) <= 10.0


def test_a_command_that_lacks_an_input_is_rejected(domain: int, carts: Path) -> None:
    bench = Bench(domain, namespace="two_carts")
    try:
        measurements, commands = bench.listen("joint_states"), bench.speak("joint_command")
        plant = bench.start(PlantNode, rig=str(carts), lockstep=True)
        bench.until(lambda: measurements)

        def say(**effort: float) -> None:
            message = JointState(name=list(effort), effort=list(effort.values()))
            message.header.stamp = measurements[-1].header.stamp
            commands.publish(message)

        say(cart=1.0)
        say(right_push=1.0)
        say(cart=1.0, right_push=math.nan)
        bench.until(lambda: plant.entry.dropped.total() == 3)
        say(right_push=-9.0, other=3.0, cart=9.0)  # in any order, among others
        bench.until(lambda: len(measurements) == 2)
        assert list(measurements[1].effort) == [5.0, pytest.approx(math.nan, nan_ok=True), -4.0]
    finally:
        bench.close()


def test_numbers_stand_where_their_names_say() -> None:
    slots = Slots([SignalPlace("a", "position"), SignalPlace("b", "effort"), SignalPlace("a", "effort")])
    message = deserialize_message(JointWriter(slots).pack(0, [1.0, 2.0, 3.0]), JointState)
    assert (list(message.name), len(message.velocity)) == (["a", "b"], 0)
    assert list(message.effort) == [3.0, 2.0]
    lists = message.position, message.velocity, message.effort
    assert (slots.read(message.name, lists), slots.named) == ([1.0, 2.0, 3.0], 3)
    found = slots.read(["c", "b", "a"], ([9.0, 9.0, 4.0], [], [7.0, 5.0]))
    assert (found[:2], slots.named) == ([4.0, 5.0], 3)
    assert math.isnan(found[2])  # the list is too short
    found = slots.read(["b"], ([], [], [6.0]))
    assert (found[1], slots.named) == (6.0, 1)


def test_a_rig_is_given_by_its_path(domain: int, carts: Path) -> None:
    bench = Bench(domain)
    try:
        node = bench.add(ReferenceNode(context=bench.context, parameter_overrides=[_path(carts)]))
        assert node.rig.name == rigs.load(carts).name
        assert list(node.settings["amplitude"]) == [1.0, 1.0]
    finally:
        bench.close()


def _path(carts: Path) -> Any:
    from rclpy.parameter import Parameter

    return Parameter("rig", value=str(carts))
