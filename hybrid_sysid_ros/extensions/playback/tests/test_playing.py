"""A bag that is played is what was recorded, in its order and time."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.support.errors import UserError

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rosgraph_msgs.msg import Clock

from hybrid_sysid_ros.extensions.playback.nodes import player
from hybrid_sysid_ros.extensions.playback.nodes.playback_clock import PlaybackClock
from hybrid_sysid_ros.extensions.playback.nodes.player import PlayerNode
from hybrid_sysid_ros.nodes.messages import SECOND, nanoseconds
from tests.node_bench import Bench, stamp_of
from tests.test_bags import START, references, states

STEP = SECOND // 200


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Twenty measurements and twenty references, five milliseconds apart."""
    return bags.write_bag(tmp_path / "run", [states(20), references(20)])


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(player, "DISCOVERY", 0.5)


def test_messages_are_published_as_they_lie_in_the_bag(bench: Bench, bag: Path) -> None:
    heard = bench.listen("joint_states")
    node = bench.start(PlayerNode, bag=str(bag), rate=10.0)
    bench.until(lambda: node.finished.done() and len(heard) == 20)
    assert [stamp_of(message) for message in heard] == [START + k * STEP for k in range(20)]
    assert heard[3].position[0] == math.sin(0.03)
    node.close()
    assert (node.sent, node.rounds) == (40, 1)


def test_a_part_of_a_bag_is_played_again_and_again(bench: Bench, bag: Path) -> None:
    heard = bench.listen("joint_states")
    topics = "/cam_beam/joint_states"
    node = bench.start(PlayerNode, bag=str(bag), rate=10.0, start=0.05, loop=True, topics=topics)
    bench.until(lambda: len(heard) >= 25)
    node.close()
    assert [stamp_of(message) - START for message in heard[:20]] == [k * STEP for k in range(10, 20)] * 2
    assert node.sent >= 25


def test_a_bag_that_rests_goes_on_by_steps(bench: Bench, bag: Path) -> None:
    heard = bench.listen("joint_states")
    node = bench.start(PlayerNode, bag=str(bag), pause=True, topics="/cam_beam/joint_states")
    bench.until(lambda: node.outlets["/cam_beam/joint_states"].get_subscription_count())
    for count in (1, 2, 3):
        node.step()
        bench.until(lambda: len(heard) == count)  # noqa: B023
    assert node.health()[0].message == "paused"
    node.pause()
    bench.until(lambda: len(heard) == 20)
    node.close()


def test_the_clock_is_never_behind_a_message(bench: Bench, bag: Path) -> None:
    reported = bench.listen("/clock", Clock)
    node = bench.start(PlayerNode, bag=str(bag), clock=True, rate=0.2, topics="/cam_beam/joint_states")
    bench.until(lambda: reported and nanoseconds(reported[-1].clock) >= START + 19 * STEP)
    node.close()
    times = [nanoseconds(message.clock) for message in reported]
    assert times == sorted(times)
    assert times[0] == START
    assert len(times) > 20  # between the messages it goes on


def test_what_cannot_be_played_is_named(bench: Bench, bag: Path, tmp_path: Path) -> None:
    for parameters, words in (
        ({}, "parameter bag is empty"),
        ({"bag": str(tmp_path / "nowhere")}, "nowhere: no such file"),
        ({"bag": str(bag), "topics": "/tf"}, "no topic /tf: the bag has /cam_beam/joint_states"),
    ):
        with pytest.raises(UserError, match=words):
            bench.start(PlayerNode, **parameters)


def test_time_runs_as_fast_as_it_is_asked_to() -> None:
    steady = [0]
    head = PlaybackClock(rate=2.0, steady=lambda: steady[0])
    head.go_to(100 * SECOND)
    assert head.until(103 * SECOND) == 1.5
    steady[0] += SECOND
    assert (head.time, head.until(103 * SECOND)) == (102 * SECOND, 0.5)
    head.pause()
    steady[0] += 60 * SECOND
    assert (head.time, head.until(103 * SECOND)) == (102 * SECOND, math.inf)
    head.step()
    assert (head.until(103 * SECOND), head.until(104 * SECOND)) == (0.0, math.inf)
    head.pause()
    assert (head.time, head.until(104 * SECOND)) == (103 * SECOND, 0.5)
