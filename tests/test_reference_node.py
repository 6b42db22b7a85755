"""The reference node: previews that agree with one another, and where they end."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from trajectory_msgs.msg import JointTrajectory

from hybrid_sysid_ros.nodes.messages import SECOND, TrajectoryMessage
from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.nodes.validation import MessageValidator
from tests.node_bench import VOLT, Bench, joint


@pytest.mark.parametrize("kind", ["hardware", "constant", "steps", "sine", "multisine"])
def test_previews_agree_where_they_overlap(bench: Bench, kind: str) -> None:
    measurements = bench.speak("joint_states")
    previews = bench.listen("reference", JointTrajectory)
    reference = bench.start(ReferenceNode, kind=kind, lockstep=True)
    bench.until(lambda: measurements.get_subscription_count() and reference.previews.get_subscription_count())
    for k in range(40):
        measurements.publish(joint(3 * SECOND + k * SECOND // 200))
        bench.executor.spin_once(timeout_sec=0.1)
    bench.until(lambda: len(previews) == 4)  # every 50 ms of 195 ms
    validator = MessageValidator(JointTrajectory, steady=lambda: 0)
    beam, tracked = Slots([SignalPlace("beam", "position")]), np.array([True])
    first, second = (Preview.of(TrajectoryMessage.of(message), validator, beam, tracked, 0) for message in previews[:2])
    assert first is not None
    assert second is not None
    times = 3 * SECOND + np.arange(60, 480, 3) * SECOND // 1000
    assert (first.at(times) == second.at(times)).all()
    assert np.abs(first.values).max() <= 4.0 * VOLT * (1 + 1e-9)


def test_a_reference_ends_after_its_duration(bench: Bench) -> None:
    measurements = bench.speak("joint_states")
    reference = bench.start(ReferenceNode, kind="sine", duration=0.5, lockstep=True)
    bench.until(measurements.get_subscription_count)
    measurements.publish(joint(SECOND))
    bench.until(lambda: reference.zero)
    assert not reference.finished.done()
    measurements.publish(joint(SECOND + SECOND // 2))
    bench.until(reference.finished.done)


def test_a_preview_is_straight_between_points_and_held_beyond() -> None:
    preview = Preview(np.array([10, 20, 40]), np.array([[1.0, 0.0], [2.0, -1.0], [0.0, 3.0]]))
    wanted = np.array([[1, 0], [1, 0], [1.5, -0.5], [2, -1], [1, 1], [0, 3], [0, 3]])
    np.testing.assert_allclose(preview.at(np.array([0, 10, 15, 20, 30, 40, 99])), wanted)
    np.testing.assert_allclose(Preview(np.array([10]), np.array([[3.0]])).at(np.array([0, 99])), [[3], [3]])
