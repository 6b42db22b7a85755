"""The recorder node: what it writes is a record, and it replaces nothing unasked."""

from __future__ import annotations

import errno
import os
import shutil
import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags import storage
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import serialize_message

from hybrid_sysid_ros.nodes import recorder as room
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
    bench.start(EstimatorNode, model=str(model_folder), lockstep=True, latency=0.0)
    network = {"policy": "network", "policy_path": str(policy_folder), "certificate": "ignore"}
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


def test_a_recorder_that_is_activated_again_goes_on_in_the_next_bag(bench: Bench, tmp_path: Path) -> None:
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="joint_states", overwrite=True)
    publisher = bench.speak("joint_states")
    for _ in range(2):
        bench.until(publisher.get_subscription_count)
        publisher.publish(joint(SECOND, position=[0.0], effort=[0.0]))
        bench.until(lambda: sum(recorder.received.values()))
        recorder.trigger_deactivate()
        bench.until(lambda: not publisher.get_subscription_count())
        recorder.trigger_activate()
    recorder.close()
    other = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="joint_states", resume=True)
    other.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "bag_2", "bag_3", "bag_4"]
    assert all(bags.topics(tmp_path / name)["/cam_beam/joint_states"].messages == 1 for name in ("bag", "bag_2"))


def test_a_recorder_takes_topics_of_other_types_when_they_appear(bench: Bench, tmp_path: Path) -> None:
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="temperature /diagnostics")
    publisher = bench.speak("temperature")
    bench.until(publisher.get_subscription_count)
    publisher.publish(joint(SECOND, effort=[1.0]))
    bench.until(lambda: recorder.received.get("/cam_beam/temperature"))
    recorder.close()
    assert bags.topics(tmp_path / "bag")["/cam_beam/temperature"].type == "sensor_msgs/msg/JointState"


def test_a_bag_keeps_what_nodes_log(bench: Bench, tmp_path: Path) -> None:
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"))
    bench.until(lambda: bench.probe.count_subscribers("/rosout"))
    bench.until(lambda: bench.probe.get_logger().info("here") and recorder.received["/rosout"])
    recorder.close()
    assert bags.topics(tmp_path / "bag")["/rosout"].type == "rcl_interfaces/msg/Log"


def test_a_recorder_does_not_replace_a_bag_unasked(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").touch()
    with pytest.raises(UserError, match="exists already"):
        bench.start(RecorderNode, path=str(tmp_path / "bag"))
    with pytest.raises(UserError, match="parameter path is empty"):
        bench.start(RecorderNode)


def tasks(heard: list[DiagnosticArray]) -> list[DiagnosticStatus]:
    """What was heard of the task recorder."""
    return [status for message in heard for status in message.status if status.name.endswith("recorder: recorder")]


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {value.key: value.value for value in status.values}


class Disk:
    """A recorder that has 50 messages on a disk which is then full, and gets 30 more."""

    def __init__(self, bench: Bench, path: Path, monkeypatch: Any) -> None:
        heard = bench.listen("/diagnostics", DiagnosticArray)
        self.recorder = bench.start(RecorderNode, path=str(path), topics="joint_states")
        publisher = bench.speak("joint_states")
        bench.until(lambda: publisher.get_subscription_count() and bench.probe.count_publishers("/diagnostics"))

        def say(begin: int, end: int) -> None:
            for k in range(begin, end):
                publisher.publish(joint(SECOND + k * 5_000_000, position=[0.0], effort=[0.0]))
            bench.until(lambda: self.recorder.received["/cam_beam/joint_states"] == end)

        def full(descriptor: int, data: bytes, place: int) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        say(0, 50)
        bench.until(lambda: self.recorder.recording.kept == 50)
        monkeypatch.setattr(storage.os, "pwrite", full)
        say(50, 80)
        bench.until(lambda: tasks(heard) and tasks(heard)[-1].level == DiagnosticStatus.ERROR)
        assert "No space left on device" in tasks(heard)[-1].message
        assert str(path) in tasks(heard)[-1].message


def test_a_full_disk_keeps_the_bag(bench: Bench, tmp_path: Path, monkeypatch: Any) -> None:
    recorder = Disk(bench, tmp_path / "bag", monkeypatch).recorder
    assert not recorder.finished.done()  # the rig is driven on
    with pytest.raises(UserError, match=r"bag: cannot be written \(No space left on device\): 50 .* kept, 30 lost"):
        recorder.close()
    found = values(recorder.health()[0].status("", ""))
    assert (found["kept"], found["lost"]) == ("50", "30")
    assert bags.read(tmp_path / "bag", load_rig("cam_beam").signals, recover=True).samples == 50


def test_a_disk_that_has_room_again_gets_what_has_waited(bench: Bench, tmp_path: Path, monkeypatch: Any) -> None:
    real = os.pwrite
    recorder = Disk(bench, tmp_path / "bag", monkeypatch).recorder
    monkeypatch.setattr(storage.os, "pwrite", real)
    bench.until(lambda: recorder.recording.kept == 80)
    assert recorder.trouble is None
    recorder.close()
    assert bags.read(tmp_path / "bag", load_rig("cam_beam").signals).samples == 80


def test_a_bag_that_somebody_removes_is_missed(bench: Bench, tmp_path: Path) -> None:
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="joint_states")
    publisher = bench.speak("joint_states")
    bench.until(publisher.get_subscription_count)
    publisher.publish(joint(SECOND, position=[0.0], effort=[0.0]))
    bench.until(lambda: recorder.recording.kept == 1)
    shutil.rmtree(tmp_path / "bag")
    bench.until(lambda: recorder.trouble)
    with pytest.raises(UserError, match=r"bag: cannot be written .*removed"):
        recorder.close()


def test_a_slow_disk_holds_nobody_up(bench: Bench, tmp_path: Path, monkeypatch: Any) -> None:
    """The memory for what waits is bounded; what is over is counted, and the rest is written when the disk answers."""
    message = joint(SECOND, position=[0.0], effort=[0.0])
    answer, asked, real = threading.Event(), threading.Event(), os.fsync
    heard = bench.listen("/diagnostics", DiagnosticArray)
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="joint_states")
    publisher = bench.speak("joint_states")
    bench.until(lambda: publisher.get_subscription_count() and bench.probe.count_publishers("/diagnostics"))
    publisher.publish(message)
    bench.until(lambda: recorder.recording.kept == 1)

    def slow(descriptor: int) -> None:
        asked.set()
        answer.wait()
        real(descriptor)

    monkeypatch.setattr(storage.os, "fsync", slow)
    monkeypatch.setattr(room, "SLOW", 0.1)
    try:
        publisher.publish(message)
        bench.until(asked.is_set)
        bench.until(lambda: tasks(heard)[-1].level == DiagnosticStatus.WARN)
        assert str(tmp_path / "bag") in tasks(heard)[-1].message
        monkeypatch.setattr(room, "QUEUE_BYTES", 1000)
        for _ in range(20):
            publisher.publish(message)
        bench.until(lambda: recorder.received["/cam_beam/joint_states"] == 22)
        bench.until(lambda: tasks(heard)[-1].level == DiagnosticStatus.ERROR)
        assert str(tmp_path / "bag") in tasks(heard)[-1].message
        assert 0 < int(values(tasks(heard)[-1])["lost"]) == recorder.lost < 20
    finally:
        answer.set()
    recorder.close()
    written = bags.topics(tmp_path / "bag")["/cam_beam/joint_states"].messages
    assert written == recorder.recording.kept == 22 - recorder.lost


def test_what_a_recorder_is_late_with_lies_in_its_place(bench: Bench, tmp_path: Path, monkeypatch: Any) -> None:
    """It has many messages of one topic to take, one by one, while fresh ones come of another."""
    monkeypatch.setattr(room, "FLUSH_PERIOD", 0.01)
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="joint_states joint_command")
    queued, fresh = bench.speak("joint_states"), bench.speak("joint_command")
    bench.until(lambda: queued.get_subscription_count() and fresh.get_subscription_count())
    for k in range(2000):
        queued.publish(joint(SECOND + k, position=[0.0]))
    for k in range(300):
        fresh.publish(joint(SECOND + k, effort=[0.0]))
        bench.executor.spin_once(timeout_sec=0.0)
    recorder.close()
    assert recorder.recording.kept == 2300  # also those that waited for their turn when it ended
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        messages = [message for _, _, message in make_reader(stream).iter_messages(log_time_order=False)]
    assert [message.log_time for message in messages] == sorted(message.log_time for message in messages)


def test_a_recorder_rather_writes_out_of_order_than_loses(bench: Bench, tmp_path: Path, monkeypatch: Any) -> None:
    """Others may always still come before what it has, and its memory is half full."""
    monkeypatch.setattr(RecorderNode, "drain", lambda self: None)
    monkeypatch.setattr(room, "QUEUE_BYTES", 30 * len(serialize_message(joint(SECOND, position=[0.0]))))
    recorder = bench.start(RecorderNode, path=str(tmp_path / "bag"), topics="joint_states")
    publisher = bench.speak("joint_states")
    bench.until(publisher.get_subscription_count)

    def are_kept(count: int) -> bool:
        return bool(recorder.recording.kept == count)

    for sent in (20, 40, 60):
        for k in range(sent - 20, sent):
            publisher.publish(joint(SECOND + k, position=[0.0]))
        bench.until(partial(are_kept, sent))
    assert recorder.lost == 0
    recorder.close()
