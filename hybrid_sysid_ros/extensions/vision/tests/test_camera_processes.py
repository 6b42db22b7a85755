"""The loop closed by a camera alone, as processes: true positions follow the reference, and every frame is read."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
pytest.importorskip("PIL", reason="needs the extra video")

from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.extensions.vision.companion import Vision
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.run import Run
from hybrid_sysid_ros.support.errors import UserError

RIG = load("cam_beam")
SECONDS = 4.0


@pytest.mark.slow
@pytest.mark.parametrize("lockstep", [True, False])
def test_a_camera_takes_the_sensor_s_place(domain: int, tmp_path: Path, lockstep: bool) -> None:
    painted_layers(RIG, Camera()).save(tmp_path / "layers")
    outcome = Run(
        companions=[Vision(layers=tmp_path / "layers")], policy="exact", reference="sine", duration=SECONDS,
        bag=tmp_path / "bag", lockstep=lockstep, domain=domain, tell=lambda line: None,
    ).go()  # fmt: skip
    frames = outcome.diagnostics["vision"]
    assert frames["frames"] >= 30 * (SECONDS - 1.5)  # the bag ends when the reference does
    assert frames["lost_frames"] == frames["unreadable_frames"] == 0
    assert outcome.diagnostics["estimator"]["camera_measurements"] > 0
    assert outcome.bag is not None
    loop = LoopRecord.from_bag(outcome.bag, RIG)
    assert loop.outputs[:, 0].max() > 3.0 * RIG.display[0].scale  # of a sine of 4 V
    assert loop.tracking_rmse(1.0, SECONDS) < 0.5


def test_a_rig_without_a_picture_of_its_output_is_refused(domain: int) -> None:
    with pytest.raises(UserError, match="a camera sees the position of"):
        Run(rig="wheel_motor", companions=[Vision()], domain=domain).go()
