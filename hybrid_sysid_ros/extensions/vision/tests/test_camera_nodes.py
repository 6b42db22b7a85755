"""Camera and vision: pictures of a motion that a test makes, positions read from them, and no encoder."""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")
pytest.importorskip("PIL", reason="needs the extra video")

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.extensions.vision.camera import jpeg
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.nodes.camera import CameraNode
from hybrid_sysid_ros.extensions.vision.nodes.vision import VisionNode
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.estimator import EstimatorNode
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds
from hybrid_sysid_ros.nodes.plant import PlantNode
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support import extensions
from tests.node_bench import VOLT, Bench, joint, stamp_of

STEP = SECOND // 1000


@pytest.fixture(scope="module")
def layers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("layers") / "layers"
    painted_layers(load("cam_beam"), Camera()).save(folder)
    return folder


def _motion(stamp: int, angles: list[float]) -> JointTrajectory:
    message = JointTrajectory(joint_names=["beam"])
    set_nanoseconds(message.header.stamp, stamp)
    for k, angle in enumerate(angles):
        point = JointTrajectoryPoint(positions=[angle])
        set_nanoseconds(point.time_from_start, (k + 1) * STEP)
        message.points.append(point)
    return message


def test_pictures_of_a_motion_are_read(bench: Bench, layers: Path) -> None:
    images = bench.listen("camera/image_raw/compressed", CompressedImage)
    infos = bench.listen("camera/camera_info", CameraInfo)
    readings: list[JointState] = bench.listen("camera/joint_states")
    motions = bench.speak("motion", JointTrajectory)
    bench.start(VisionNode, layers=str(layers), lockstep=True)
    camera: CameraNode = bench.start(CameraNode, lockstep=True)
    bench.until(motions.get_subscription_count)
    bench.until(lambda: camera.images.get_subscription_count() == 2)
    begin, speed = 50 * SECOND, 0.2
    for k in range(40):
        motions.publish(_motion(begin + 5 * k * STEP, [speed * (5 * k + i + 1) * 1e-3 for i in range(5)]))
        bench.executor.spin_once(timeout_sec=0.0)
    bench.until(lambda: len(readings) >= 6)
    assert len(images) == len(infos) == camera.frames
    assert (infos[0].width, infos[0].height, images[0].format) == (640, 360, "jpeg")
    assert stamp_of(images[1]) - stamp_of(images[0]) == pytest.approx(SECOND / 30, abs=1)
    for reading in readings[1:]:
        assert list(reading.name) == ["beam_camera", "beam_camera_deviation"]
        true = speed * (stamp_of(reading) - begin) * 1e-9
        position, deviation = reading.position
        assert math.degrees(position - true) == pytest.approx(0.0, abs=0.03)
        assert 0.0 < math.degrees(deviation) < 0.02


def test_a_picture_that_is_none_is_answered_without_a_number(bench: Bench, layers: Path) -> None:
    readings: list[JointState] = bench.listen("camera/joint_states")
    images = bench.speak("camera/image_raw/compressed", CompressedImage)
    vision: VisionNode = bench.start(VisionNode, layers=str(layers), lockstep=True)
    bench.until(images.get_subscription_count)
    bench.until(lambda: vision.readings and vision.readings.get_subscription_count())
    images.publish(CompressedImage(format="jpeg", data=[1, 2, 3]))
    assert math.isnan(bench.until(lambda: readings)[0].position[0])
    assert vision.unreadable == 1


@pytest.mark.parametrize("spoilt", ["moved", "frozen"])
def test_a_camera_that_was_moved_or_hangs_tells_nothing(bench: Bench, layers: Path, spoilt: str) -> None:
    """A lens that looks two degrees beside, 21 of 640 pixels at a view of 60 degrees; then all is well again."""
    readings: list[JointState] = bench.listen("camera/joint_states")
    images = bench.speak("camera/image_raw/compressed", CompressedImage)
    vision: VisionNode = bench.start(VisionNode, layers=str(layers), lockstep=True)
    bench.until(images.get_subscription_count)
    bench.until(lambda: vision.readings and vision.readings.get_subscription_count())
    imager, rest = Imager(scene_of(load("cam_beam")), Camera()), (np.array([-1.0, 1.0]), np.full(2, 0.03))

    def picture(move: int = 0) -> bytes:
        return jpeg.encoded(np.roll(imager.take(0.0, *rest), move, axis=1), 80)

    def reported(data: bytes) -> bool:
        """Whether the node says a position by a picture."""
        count = len(readings)
        images.publish(CompressedImage(format="jpeg", data=array("B", data)))
        return math.isfinite(bench.until(lambda: readings[count:])[0].position[0])

    assert all(reported(picture()) for _ in range(12))
    if spoilt == "moved":
        assert not any([reported(picture(21)) for _ in range(70)][60:])
        assert vision.displaced > 10
    else:
        last = picture()
        assert [reported(last) for _ in range(6)] == [True, True, False, False, False, False]
        assert vision.frozen == 4
    assert all([reported(picture()) for _ in range(70)][60:])


def test_a_camera_alone_gives_the_first_value(bench: Bench, model_folder: Path) -> None:
    measurements, frames = bench.speak("joint_states"), bench.speak("camera/joint_states")
    estimates = bench.listen("state_estimate")
    estimator: EstimatorNode = bench.start(
        EstimatorNode, model=str(model_folder), lockstep=True, frozen_after=0.0, camera_noise=0.01
    )
    bench.until(lambda: frames.get_subscription_count() and measurements.get_subscription_count())
    bench.until(lambda: estimator.estimates and estimator.estimates.get_subscription_count())
    stamp, period = 100 * SECOND, SECOND // 200
    measurements.publish(joint(stamp, position=[math.nan], effort=[1.0]))
    bench.until(lambda: estimator.unusable)
    frames.publish(joint(stamp - 12 * STEP, name=["beam_camera", "beam_camera_deviation"], position=[0.02, 1e-4]))
    answer = bench.until(lambda: estimates)[0]
    assert stamp_of(answer) == stamp
    assert answer.position[0] == pytest.approx(0.02, abs=2e-3)
    for k in range(1, 15):
        measurements.publish(joint(stamp + k * period, position=[math.nan], effort=[1.0]))
        bench.until(lambda: estimates[k:])  # noqa: B023
    assert all(math.isfinite(estimate.position[0]) for estimate in estimates)


def test_in_lockstep_the_plant_waits_for_frames_that_are_due(bench: Bench) -> None:
    measurements, commands = bench.listen("joint_states"), bench.speak("joint_command")
    frames = bench.speak("camera/joint_states")
    plant: PlantNode = bench.start(PlantNode, lockstep=True, camera_rate=30.0, camera_latency=0.025)
    bench.until(lambda: measurements)
    first = stamp_of(measurements[0])

    def answer() -> None:
        commands.publish(joint(stamp_of(measurements[-1]), effort=[0.0]))

    while stamp_of(measurements[-1]) < first + 20 * STEP:
        count = len(measurements)
        answer()
        bench.until(lambda: measurements[count:])  # noqa: B023
    answer()  # to a measurement 25 ms after the first frame, which has not come
    bench.until(lambda: plant.answers.answered == plant.answers.latest)
    count = len(measurements)
    for _ in range(5):
        bench.executor.spin_once(timeout_sec=0.01)
    assert len(measurements) == count
    frames.publish(joint(first - 12 * STEP, name=["beam_camera"], position=[0.0]))
    bench.until(lambda: len(measurements) > count)


@pytest.mark.parametrize("answered", [True, False])
def test_in_real_time_the_rig_goes_when_a_camera_has_seen_it(bench: Bench, answered: bool) -> None:
    """Or when one that shows nothing has had its half second."""
    measurements, motions = bench.listen("joint_states"), bench.listen("motion", JointTrajectory)
    bench.speak("joint_command")
    frames = bench.speak("camera/joint_states")
    bench.start(PlantNode, camera_rate=30.0, wait_for_readers=1)
    stamp = stamp_of(bench.until(lambda: motions)[0])
    if answered:
        frames.publish(joint(stamp - 12 * STEP, name=["beam_camera"], position=[0.0]))
    waited = (stamp_of(bench.until(lambda: measurements)[0]) - stamp) / SECOND
    assert 0.0 < waited < 0.5 if answered else waited >= 0.5


@pytest.mark.parametrize("said", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_picture_is_the_goal_of_a_loop_by_camera_alone(
    bench: Bench, layers: Path, model_folder: Path, tmp_path: Path, said: bool
) -> None:
    """Said to the commander, or weighed by the controller pixel by pixel."""
    rig = load("cam_beam")
    shown = Imager(scene_of(rig), Camera()).take(0.0, np.array([-1.0, 1.0]), np.full(2, 2.0 * VOLT))
    (tmp_path / "goal.jpg").write_bytes(jpeg.encoded(shown, 80))
    goal = {} if said else {"picture": str(tmp_path / "goal.jpg"), "layers": str(layers)}
    model = str(model_folder)
    bench.start(ControllerNode, model=model, policy="exact", lockstep=True, latency=0.0, **goal)
    estimator: EstimatorNode = bench.start(EstimatorNode, model=model, lockstep=True, latency=0.0, camera_noise=0.01)
    bench.start(ReferenceNode, kind="constant", amplitude=0.0, lockstep=True)
    bench.start(VisionNode, layers=str(layers), lockstep=True)
    bench.start(CameraNode, lockstep=True)
    readings = bench.listen("camera/joint_states")
    if said:
        kind = pytest.importorskip(f"{extensions.GROUP}.commander.nodes.commander").CommanderNode
        commander = bench.start(kind, armed=True, folder=str(tmp_path), layers=str(layers))
        text, replies = bench.speak("command_text", String), bench.listen("command_reply", DiagnosticStatus)
    plant: PlantNode = bench.start(
        PlantNode, lockstep=True, wait_for_readers=0, bias=0.0, sensor_out=[1.0], camera_rate=30.0
    )
    if said:
        bench.until(lambda: commander.interpreting.interpreter is not None)
        bench.until(lambda: {"state_estimate", "reference"} <= commander.monitor.newest.keys())
        text.publish(String(data="make it look like goal.jpg"))
        bench.until(lambda: replies)
        assert replies[0].level == DiagnosticStatus.OK, replies[0].message
        assert "goal.jpg" in replies[0].message
    bench.until(lambda: abs(plant.plant.state[0] - 2.0 * VOLT) < 0.03 * VOLT)
    bench.until(lambda: estimator.seen > 10)
    assert math.isfinite(readings[-1].position[0])
    assert abs(plant.plant.state[0] - 2.0 * VOLT) < 0.1 * VOLT
