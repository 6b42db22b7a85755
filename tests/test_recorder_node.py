"""The recorder node: what it writes is a record, and it replaces nothing unasked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.recorder import RecorderNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from tests.node_bench import Bench, joint


def test_a_recorded_bag_is_a_record(domain: int, tmp_path: Path, model_folder: Path, policy_folder: Path) -> None:
    bench = Bench(domain)
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"))
    bench.start(ReferenceNode, lockstep=True)
    bench.start(EstimatorNode, model=str(model_folder), latency=0.0)
    network = {"policy": "network", "policy_path": str(policy_folder)}
    bench.start(ControllerNode, model=str(model_folder), lockstep=True, latency=0.0, **network)
    plant = bench.start(PlantNode, lockstep=True, wait_for_readers=3, duration=1.0)
    bench.until(plant.finished.done)
    plant.report()
    bench.until(lambda: recorder.received["/cam_beam/joint_states"] == 201 and recorder.received["/diagnostics"])
    recorder.close()
    bench.close()
    record = bags.read(tmp_path / "bag", load_rig("cam_beam").signals)
    assert (record.samples, record.sampling_time) == (201, 0.005)
    assert set(record.channels) == {"filtered", "reference", "command"}
    np.testing.assert_allclose(record.input[:-2, 0], record.channels["command"][:-2], atol=1e-12)
    recorded = bags.topics(tmp_path / "bag")
    assert recorded["/cam_beam/state_estimate"].messages > 190
    assert "/diagnostics" in recorded


def test_a_recorder_takes_topics_of_other_types_when_they_appear(bench: Bench, tmp_path: Path) -> None:
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="temperature /diagnostics")
    publisher = bench.speak("temperature")
    bench.until(publisher.get_subscription_count)
    publisher.publish(joint(SECOND, effort=[1.0]))
    bench.until(lambda: recorder.received.get("/cam_beam/temperature"))
    recorder.close()
    assert bags.topics(tmp_path / "bag")["/cam_beam/temperature"].type == "sensor_msgs/msg/JointState"


def test_a_recorder_does_not_replace_a_bag_unasked(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").touch()
    with pytest.raises(UserError, match="exists already"):
        bench.start(RecorderNode, path=str(tmp_path / "bag"))
    with pytest.raises(UserError, match="parameter path is empty"):
        bench.start(RecorderNode)
