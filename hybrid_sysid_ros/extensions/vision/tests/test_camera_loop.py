"""A loop that a camera alone closes: what its nodes are told, and which rigs can't have one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.extensions.vision import camera_loop
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.errors import UserError

RIG = load("cam_beam")
SECOND, PERIOD, STEP = 1_000_000_000, 5_000_000, 1_000_000  # ns


def test_the_nodes_know_what_they_are_given(tmp_path: Path) -> None:
    pytest.importorskip("PIL", reason="needs the extra video")
    found = camera_loop.parameters(RIG, tmp_path)
    for node, values in found.items():
        known = configuration.parameters(RIG, node)
        assert all(known[name].checked(value) == value for name, value in values.items())
    assert found["plant"]["sensor_out"] == [1.0]
    assert found["estimator"]["camera_noise"] == pytest.approx(0.01, rel=0.05)  # V: see the loop of benchmarks.camera


def test_a_rig_whose_first_output_is_no_picture_can_t_be_closed_by_one() -> None:
    with pytest.raises(UserError, match="a camera sees the position of"):
        camera_loop.frame_noise(load("wheel_motor"), 640)
    with pytest.raises(UserError, match="no section scene"):
        camera_loop.frame_noise(load("winged_cone"), 640)


def test_the_truth_stands_in_for_a_sensor_that_was_out(tmp_path: Path) -> None:
    count = 40
    stamps = SECOND + PERIOD * np.arange(count)
    true = 0.01 * np.sin(np.arange(count * 5 + 1) / 30.0)  # at each step
    nothing, effort = np.full((count, 1), np.nan), np.zeros((count, 1))
    series = [
        bags.joint_states("/cam_beam/joint_states", stamps, ["beam"], position=nothing, effort=effort),
        bags.joint_states("/cam_beam/joint_command", stamps, ["beam"], effort=effort),
        bags.joint_trajectories(
            "/cam_beam/reference", stamps, ["beam"], positions=np.zeros((count, 2, 1)), times=np.array([0.0, 0.005])
        ),
    ]
    with pytest.raises(UserError, match=r"position\[beam\] is nan"):
        LoopRecord.from_bag(bags.write_bag(tmp_path / "blind", series), RIG)
    first = bags.joint_trajectories(
        "/cam_beam/motion", stamps[:1], ["beam"], positions=true[None, :1, None], times=np.zeros(1)
    )
    steps = 5 * np.arange(count - 1)[:, None] + np.arange(1, 6)
    others = bags.joint_trajectories(
        "/cam_beam/motion", stamps[:-1], ["beam"], positions=true[steps][:, :, None], times=1e-3 * np.arange(1, 6)
    )
    loop = LoopRecord.from_bag(_with(tmp_path / "seen", series, first, others), RIG)
    np.testing.assert_allclose(loop.outputs[1:, 0], true[5 : 5 * count : 5], atol=1e-12)


def _with(path: Path, series: list[bags.Series], first: bags.Series, others: bags.Series) -> Path:
    with bags.BagWriter(path) as writer:
        for item in (*series, first, others):
            for stamp, message in zip(item.stamps.tolist(), item.messages(), strict=True):
                writer.write_raw(item.topic, item.type, stamp, message)
    return path
