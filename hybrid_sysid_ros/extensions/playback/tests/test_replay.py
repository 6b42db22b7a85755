"""A recorded loop explains itself, and its estimator and controller answer the same when they are asked again."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.extensions.playback.comparison import compare, unit_of
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration, run_provenance
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.runtime.run import Run

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.recorder import RecorderNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from tests.manager import set_parameter
from tests.node_bench import Bench
from tests.test_bags import references, stamps, states

RIG = rigs.load("cam_beam")
TOPICS = ("joint_states", "reference", "state_estimate", "joint_command")
NAMES = {topic: f"/cam_beam/{topic}" for topic in TOPICS}
ESTIMATES, COMMANDS = 1e-9, 1e-6  # that a replay in lockstep must be as near as


@pytest.fixture(scope="module")
def loop(domain: int, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second and a half in lockstep, under the shipped network and its supervision, with a bias to estimate."""
    bag = tmp_path_factory.mktemp("run") / "loop"
    Run(
        reference="sine", duration=1.5, lockstep=True, composed=True, bag=bag, domain=domain, tell=lambda line: None,
        parameters={"plant": {"bias": [0.3]}, "estimator": {"process_noise": [0.002]}},
    ).go()  # fmt: skip
    return bag


@pytest.fixture
def command(call: Callable[..., tuple[int, str, str]]) -> Callable[..., tuple[int, str, str]]:
    """Run hybrid-sysid with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid")


def replayed(command: Any, bag: Path, out: Path, *options: object) -> dict[str, Any]:
    """The numbers of a replay."""
    status, _, error = command("replay", bag, "--out", out, *options)
    assert status == 0, error
    return json.loads((out / "replay.json").read_text())  # type: ignore[no-any-return]


def largest(numbers: dict[str, Any], topic: str) -> float:
    return max(number["largest"] for number in numbers[topic]["numbers"].values())


def test_a_recorded_loop_explains_itself(loop: Path, tmp_path: Path) -> None:
    """Parameters of all nodes, and the very model and policy."""
    found = bags.attached(loop)
    reported = {
        node: run_provenance.parameters(found, node) for node in ("plant", "reference", "estimator", "controller")
    }
    assert reported["plant"]["bias"] == [0.3]
    assert reported["estimator"]["process_noise"] == [0.002] * len(RIG.system.states)
    assert reported["controller"]["lockstep"] is True
    for node, values in reported.items():
        assert values.keys() == {"rig", *configuration.parameters(RIG, node)}
    model = load_model(bags.laid_out(found, tmp_path, below="controller/model"))
    assert model.seal == load_model(shipped(RIG.name, "model")).seal
    policy.load(bags.laid_out(found, tmp_path, below="controller/policy"), model=model)  # whose seals fit


def test_a_recorded_loop_lies_in_the_order_of_its_times(loop: Path) -> None:
    with (loop / "loop_0.mcap").open("rb") as stream:
        messages = [message for _, _, message in make_reader(stream).iter_messages(log_time_order=False)]
    logged = np.array([message.log_time for message in messages])
    published = np.array([message.publish_time for message in messages])
    assert (np.diff(logged) >= 0).all()
    assert (published <= logged).all()
    assert (published < logged).any()  # it is the sender's time


def test_a_loop_in_lockstep_is_replayed_to_the_last_digits(command: Any, loop: Path, tmp_path: Path) -> None:
    numbers = replayed(command, loop, tmp_path / "out")
    assert numbers["lockstep"]
    assert numbers["parameters"] == "as the bag says"
    assert numbers["state_estimate"]["recorded"] >= 300
    for topic, near in (("state_estimate", ESTIMATES), ("joint_command", COMMANDS)):
        assert numbers[topic]["common"] == numbers[topic]["recorded"]
        assert largest(numbers, topic) <= near
    assert numbers["state_estimate"]["numbers"]["velocity[beam_ahead]"]["unit"] == "rad/s"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "velocity[beam]" in page
    assert "effort[beam]" in page
    again = compare(loop, tmp_path / "out" / "replayed", RIG)
    assert again.content["joint_command"] == numbers["joint_command"]


@pytest.mark.slow
def test_what_changed_while_it_was_recorded_changes_again(command: Any, domain: int, tmp_path: Path) -> None:
    """Half of the bag with one weight of the input's rate, half with another."""
    bench = Bench(domain)
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"))
    bench.start(ReferenceNode, lockstep=True)
    bench.start(EstimatorNode, lockstep=True, latency=0.0)
    controller = bench.start(ControllerNode, lockstep=True, latency=0.0, policy="exact")
    plant = bench.start(PlantNode, lockstep=True, wait_for_readers=3, duration=2.0)
    bench.until(lambda: recorder.received["/cam_beam/joint_command"] > 200)
    weight = [100.0 * value for value in controller.settings["rate_weight"]]
    assert set_parameter(bench, "controller", "rate_weight", weight) == ""
    bench.until(plant.finished.done)
    bench.until(lambda: len(recorder.attachments) == 0 and recorder.received["/cam_beam/joint_command"] >= 400)
    recorder.close()
    bench.close()
    numbers = replayed(command, tmp_path / "bag", tmp_path / "out")
    assert largest(numbers, "joint_command") <= COMMANDS


def test_a_bag_that_says_nothing_of_itself_is_replayed_by_defaults(command: Any, loop: Path, tmp_path: Path) -> None:
    """What this one was recorded with is other than the defaults, and the replay shows it."""
    with bags.bag.opened(loop) as bag, bags.BagWriter(tmp_path / "bare") as writer:
        for name, logged, data in bag.messages(NAMES.values()):
            writer.write_raw(name, bag.topics[name].type, logged, data)
    numbers = replayed(command, tmp_path / "bare", tmp_path / "out")
    assert numbers["lockstep"]
    assert "defaults" in numbers["parameters"]
    assert largest(numbers, "state_estimate") > ESTIMATES


@pytest.mark.slow
def test_another_driver_answers_otherwise(command: Any, loop: Path, tmp_path: Path) -> None:
    numbers = replayed(command, loop, tmp_path / "out", "--policy", "exact")
    assert largest(numbers, "state_estimate") <= ESTIMATES
    assert largest(numbers, "joint_command") > COMMANDS


def test_another_model_is_driven_by_the_exact_mpc(command: Any, loop: Path, model_folder: Path, tmp_path: Path) -> None:
    """The recorded network was trained for the recorded model."""
    status, out, error = command("replay", loop, "--model", model_folder, "--out", tmp_path / "out")
    assert status == 0, error
    assert "policy exact" in out
    numbers = json.loads((tmp_path / "out" / "replay.json").read_text())
    assert largest(numbers, "state_estimate") > ESTIMATES


def test_what_a_replay_needs_is_named(command: Any, loop: Path, tmp_path: Path) -> None:
    bag = bags.write_bag(tmp_path / "run", [states(20)])
    for arguments, words in (
        ((bag,), ["no messages of /cam_beam/reference", "/cam_beam/joint_states"]),
        ((tmp_path / "nowhere",), ["nowhere: no such file"]),
        ((loop, "--model", tmp_path / "nowhere"), ["nowhere"]),
        ((loop, "--policy", "fast"), ["policy", "fast"]),
        ((loop, "--rig", "wheel_motor"), ["no messages of /wheel_motor/joint_states"]),
    ):
        status, _, error = command("replay", *arguments)
        assert status == 2
        assert error.splitlines()[-1].startswith("error: ")
        assert "Traceback" not in error
        for word in words:
            assert word in error


def test_the_comparison_finds_what_differs(tmp_path: Path) -> None:
    """Under the same stamps, whatever else there is; a number in one bag alone is no small difference."""
    first, second = np.zeros((50, 2)), np.zeros((50, 2))
    second[20, 0], second[30, 1] = 0.25, np.nan
    for name, values, skipped in (("a", first, 0), ("b", second, 5)):
        at, numbers = stamps(50)[skipped:], values[skipped:]
        names = ["beam", "spare"]
        series = [bags.joint_states(NAMES[t], at, names, position=numbers, effort=numbers) for t in TOPICS[2:]]
        bags.write_bag(tmp_path / name, [*series, references(10)])
    found = compare(tmp_path / "a", tmp_path / "b", RIG)
    assert (found.recorded["joint_command"], found.replayed["joint_command"]) == (50, 45)
    assert found.common["joint_command"] == 45
    compared = {number.field: number for number in found.of("joint_command")}
    assert compared["effort[beam]"].largest == 0.25
    assert compared["effort[beam]"].rms == pytest.approx(0.25 / np.sqrt(45))
    assert compared["effort[beam]"].settled == 0.0
    assert compared["effort[spare]"].largest == np.inf
    assert found.content["joint_command"]["numbers"]["effort[spare]"]["largest"] is None
    assert (unit_of(RIG, "beam", "effort"), unit_of(RIG, "spare", "effort")) == ("V", "")
