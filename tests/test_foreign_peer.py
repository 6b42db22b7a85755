"""Another implementation of DDS, with message types of its own, in the places of driver and controller."""

# No postponed annotations: cyclonedds reads them as they are.

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
pytest.importorskip("cyclonedds", reason="needs the foreign peer: install hybrid_sysid_ros[dev]")

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.plant import PlantNode
from tests.node_bench import Bench

LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""Where ROS stays on this machine, so must the peer."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):  # type: ignore[call-arg]
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):  # type: ignore[call-arg]
    stamp: Time
    frame_id: str


@dataclass
class Joints(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):  # type: ignore[call-arg]
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


class Peer:
    """Reads and writes joint messages."""

    def __init__(self, domain: int, namespace: str) -> None:
        self.participant = DomainParticipant(domain)
        self.namespace = namespace
        self.reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
        self.best_effort = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(10))

    def topic(self, name: str) -> Any:
        return Topic(self.participant, f"rt/{self.namespace}/{name}", Joints)

    def reader(self, name: str) -> Any:
        return DataReader(self.participant, self.topic(name), qos=self.reliable)

    def writer(self, name: str, *, reliable: bool = True) -> Any:
        return DataWriter(self.participant, self.topic(name), qos=self.reliable if reliable else self.best_effort)


def taken(reader: Any) -> list[Joints]:
    """What has come; of a writer that is gone no data."""
    return [sample for sample in reader.take(100) if sample.sample_info.valid_data]


@pytest.fixture
def peer(bench: Bench, domain: int, monkeypatch: pytest.MonkeyPatch) -> Peer:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    return Peer(domain, bench.namespace)


@pytest.mark.slow
def test_a_foreign_controller_drives_the_plant(bench: Bench, peer: Peer) -> None:
    reader, writer = peer.reader("joint_states"), peer.writer("joint_command")
    node = bench.start(PlantNode, lockstep=True)
    seen: list[Joints] = []

    def answered() -> bool:
        for measurement in taken(reader):
            seen.append(measurement)
            answer = Joints(measurement.header, ["beam"], [], [], [2.0])
            writer.write(answer)
        return len(seen) > 20

    bench.until(answered)
    assert node.answers.commands >= 20
    assert node.rejected == 0
    assert seen[-1].name[0] == "beam"
    assert seen[-1].effort[0] == pytest.approx(2.0)
    assert math.isfinite(seen[-1].position[0])


@pytest.mark.parametrize("reliable", [True, False])
def test_a_foreign_driver_is_answered_with_estimates(
    bench: Bench, peer: Peer, model_folder: Path, reliable: bool
) -> None:
    reader, writer = peer.reader("state_estimate"), peer.writer("joint_states", reliable=reliable)
    bench.start(EstimatorNode, model=str(model_folder), lockstep=True, frozen_after=0.0)
    found: list[Joints] = []
    stamp = 0

    def answered() -> bool:
        nonlocal stamp
        stamp += 1
        writer.write(Joints(Header(Time(100 + stamp // 200, stamp % 200 * 5_000_000), ""), ["beam"], [0.01], [], [1.0]))
        found.extend(taken(reader))
        return len(found) > 30

    bench.until(answered)
    validity = ["doubt", "sensors_left_out", "input_reversed"]
    assert list(found[-1].name) == ["beam", "beam_ahead", "beam_applied", *validity]
    assert found[-1].position[0] == pytest.approx(0.01, abs=1e-3)
