"""The reference node: previews that agree with one another, and where they end."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.nodes.diagnostics import OK
from hybrid_sysid_ros.nodes.messages import SECOND, TrajectoryMessage, nanoseconds, set_nanoseconds
from hybrid_sysid_ros.nodes.preview import Preview
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.nodes.signal_layout import SignalPlace, Slots
from hybrid_sysid_ros.nodes.validation import MessageValidator, Reason
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


DAY = 86_400 * SECOND


def trajectory(
    stamp: int, values: Sequence[float], *, name: str = "beam", spacing: int = SECOND // 10
) -> JointTrajectory:
    message = JointTrajectory(joint_names=[name])
    set_nanoseconds(message.header.stamp, stamp)
    for k, value in enumerate(values):
        point = JointTrajectoryPoint(positions=[value])
        set_nanoseconds(point.time_from_start, SECOND + k * spacing)
        message.points.append(point)
    return message


REFUSED = {
    "of yesterday": (trajectory(-DAY, [0.1]), Reason.LONG_PAST),
    "of tomorrow": (trajectory(DAY, [0.1]), Reason.AHEAD),
    "NaN": (trajectory(0, [math.nan, 0.1]), Reason.NO_NUMBER),
    "beyond all": (trajectory(0, [1e12]), Reason.OUT_OF_RANGE),
    "of another joint": (trajectory(0, [0.1], name="arm"), Reason.UNNAMED),
    "falling times": (trajectory(0, [0.1, 0.2], spacing=-SECOND // 10), Reason.NO_ORDER),
    "no points": (trajectory(0, []), Reason.MALFORMED),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_set_point_that_makes_no_sense_is_refused_and_told(bench: Bench, case: str) -> None:
    message, reason = REFUSED[case]
    if nanoseconds(message.header.stamp):
        set_nanoseconds(message.header.stamp, time.time_ns() + nanoseconds(message.header.stamp))
    measurements = bench.speak("joint_states")
    wishes = bench.speak("set_point", JointTrajectory)
    reference = bench.start(ReferenceNode, kind="constant", amplitude=0.0)
    bench.until(lambda: measurements.get_subscription_count() and wishes.get_subscription_count())
    measurements.publish(joint(time.time_ns(), position=[0.0]))
    bench.until(lambda: reference.sent)
    wishes.publish(message)
    bench.until(lambda: reference.wishes.dropped[reason] == 1)
    (task,) = reference.health()
    assert task.level != OK
    assert f"1 set-points {reason.value}" in task.message
    assert reference.choice.kind == "constant"
    wishes.publish(trajectory(time.time_ns(), [0.1]))
    bench.until(lambda: reference.choice.kind == "set_point")


def test_a_preview_that_is_stamped_well_before_the_last_one_is_refused() -> None:
    beam, tracked = Slots([SignalPlace("beam", "position")]), np.array([True])
    validator = MessageValidator(
        JointTrajectory, clock=lambda: 100 * SECOND, steady=lambda: 0, ahead=SECOND, behind=math.inf
    )

    def accepted(stamp: int) -> bool:
        message = TrajectoryMessage.of(trajectory(stamp, [0.1]))
        return Preview.of(message, validator, beam, tracked, 100 * SECOND) is not None

    assert [accepted(stamp) for stamp in (99 * SECOND, 90 * SECOND, 98 * SECOND + 1, 0)] == [True, False, True, True]
    assert validator.dropped == {Reason.BACKWARDS: 1}


def test_a_preview_is_straight_between_points_and_held_beyond() -> None:
    preview = Preview(np.array([10, 20, 40]), np.array([[1.0, 0.0], [2.0, -1.0], [0.0, 3.0]]))
    wanted = np.array([[1, 0], [1, 0], [1.5, -0.5], [2, -1], [1, 1], [0, 3], [0, 3]])
    np.testing.assert_allclose(preview.at(np.array([0, 10, 15, 20, 30, 40, 99])), wanted)
    np.testing.assert_allclose(Preview(np.array([10]), np.array([[3.0]])).at(np.array([0, 99])), [[3], [3]])
