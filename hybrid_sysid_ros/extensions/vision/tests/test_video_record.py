"""Films of rigs whose bags have no position of what is seen: by speed, or by the input, and identified from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.extensions.vision.camera.filming import SceneMotion, experiment
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.extensions.vision.reading import joint_reference, video_record
from hybrid_sysid_ros.extensions.vision.reading.footage import Footage
from hybrid_sysid_ros.extensions.vision.reading.joint_reference import JointReference, MotionSource
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.unused_pictures import (
    copied_pictures,
    frozen_pictures,
    leaping_pictures,
)
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.extensions.vision.tests.camera_bench import painted_layers
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SHIFT, PERIOD, DEVIATION = -0.7, 1 / 60, 1e-4
SECONDS = 8.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenExperiment:
    """An experiment and what a camera saw of it."""

    rig: Rig
    bag: Path
    motion: SceneMotion
    footage: Footage
    layers: PictureLayers


def _seen_experiment(name: str, folder: Path, begin: float = 0.9) -> SeenExperiment:
    rig = load(name)
    motion = experiment(rig, "multisine", folder / name, seed=2, duration=SECONDS, rate=200.0)
    times: Array = np.arange(begin, SECONDS, PERIOD, dtype=np.float64)
    angles = np.interp(times + SHIFT, motion.times, motion.angles)
    angles = angles + DEVIATION * np.random.default_rng(0).standard_normal(len(times))
    nothing = np.full(len(times), np.nan)
    footage = Footage(
        times=times, seen=times, angles=angles, deviations=np.full(len(times), DEVIATION),
        explained=np.ones(len(times)), lamp=nothing, unused={}, shown=(),
        stated_rate=1 / PERIOD,
    )  # fmt: skip
    layers = painted_layers(rig, Camera(width=240, height=136))
    return SeenExperiment(rig=rig, bag=folder / name, motion=motion, footage=footage, layers=layers)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> SeenExperiment:
    return _seen_experiment("wheel_motor", tmp_path_factory.mktemp("wheel"))


def test_a_film_is_put_in_a_bags_time_by_the_speed(wheel: SeenExperiment) -> None:
    record = video_record.joined(wheel.footage, wheel.layers, wheel.rig, wheel.bag, exposure=0.008)
    assert record.reference is not None
    assert record.reference.kind is MotionSource.SPEED
    assert record.synchronisation is not None
    assert record.synchronisation.shift == pytest.approx(SHIFT, abs=1e-3)  # its sensor is 5 ms late, by its window
    assert record.synchronisation.scale == pytest.approx(1.0, abs=0.01)
    assert any("by its speed" in line for line in video_record.contradictions(record))


def test_a_film_in_a_bags_time_by_a_speed_is_as_uncertain_as_that_time(wheel: SeenExperiment) -> None:
    """Its angles are known to a ten thousandth; at ten radians a second, a tenth of a millisecond is a thousandth."""
    record = video_record.joined(wheel.footage, wheel.layers, wheel.rig, wheel.bag, exposure=0.008)
    assert record.reference is not None
    when = (record.stamps - record.reference.origin) * 1e-9
    error = record.positions - np.interp(when, wheel.motion.times, wheel.motion.angles)
    error -= error.mean()  # the zero is free
    assert np.mean(np.abs(error) <= 1.645 * record.footage.deviations) > 0.8


def test_a_film_is_put_in_a_bags_time_by_the_input(wheel: SeenExperiment, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = joint_reference._by_input(wheel.rig, "wheel", wheel.bag)

    def by_input(rig: Rig, joint: str, bag: Path) -> JointReference:
        return reference

    monkeypatch.setattr(video_record, "joint_reference", by_input)
    record = video_record.joined(wheel.footage, wheel.layers, wheel.rig, wheel.bag, exposure=0.008)
    assert record.synchronisation is not None
    assert record.synchronisation.shift == pytest.approx(SHIFT, abs=0.02)


@pytest.mark.parametrize(("name", "begin"), [("wheel_motor", 0.9), ("flexible_joint", -0.5)])
def test_a_written_bag_is_read_with_the_camera_in_the_sensors_place(name: str, begin: float, tmp_path: Path) -> None:
    """Also where the film begins before the bag, and before time 0, and the bag has another output, too."""
    taken = _seen_experiment(name, tmp_path, begin)
    record = video_record.joined(taken.footage, taken.layers, taken.rig, taken.bag, exposure=0.008)
    joint = scene_of(taken.rig).joint
    written = video_record.at_rate(record, video_record.usual_rate(record))
    video_record.write(written, taken.rig, joint, taken.bag, tmp_path / "out", replace=False, made_by="test")
    video_record.write_signals(tmp_path / "signals.yaml", taken.rig, joint)
    system = taken.rig.system
    signals = Signals.load(tmp_path / "signals.yaml").ordered(system.inputs, system.outputs)
    seen = bags.read(tmp_path / "out", signals)
    own = bags.read(taken.bag, replace(taken.rig.signals, channels={}))
    assert seen.sampling_time == pytest.approx(own.sampling_time)
    for column in range(len(system.outputs)):
        assert np.ptp(seen.output[:, column]) == pytest.approx(np.ptp(own.output[:, column]), rel=0.1)


@pytest.mark.parametrize("held", [0.0, 0.01])
def test_what_a_film_is_off_by_beside_its_sensor_is_in_its_deviation_and_said(held: float, tmp_path: Path) -> None:
    """A codec that draws the joint anew only where it is a step farther: a uniform error, which no picture tells, and
    part of which, at 60 pictures a second, is faster than what film and sensor are compared by.
    """
    taken = _seen_experiment("cam_beam", tmp_path)
    angles = held * np.round(taken.footage.angles / held) if held else taken.footage.angles
    footage = replace(taken.footage, angles=angles)
    record = video_record.joined(footage, taken.layers, taken.rig, taken.bag, exposure=0.008)
    off = float(np.hypot(held / np.sqrt(12.0), DEVIATION))
    assert 0.6 * off < float(np.median(record.footage.deviations)) < 1.3 * off
    assert any("beyond their noise" in line for line in video_record.contradictions(record)) == bool(held)


@pytest.mark.parametrize("name", ["cam_beam", "wheel_motor"])
def test_a_second_in_which_film_and_sensor_contradict_each_other_is_refused(name: str, tmp_path: Path) -> None:
    """As where the camera hangs, but is not seen to; synchronisation alone would pass over it."""
    taken = _seen_experiment(name, tmp_path)
    angles = taken.footage.angles.copy()
    moved = np.abs(angles[60:] - angles[:-60])[60:-60]
    begin = int(np.argmax(moved)) + 60
    angles[begin : begin + 60] = angles[begin]
    with pytest.raises(UserError, match="elsewhere than the bag's sensor has it from"):
        video_record.joined(replace(taken.footage, angles=angles), taken.layers, taken.rig, taken.bag, exposure=0.008)


def test_single_pictures_that_contradict_the_sensor_are_left_out(tmp_path: Path) -> None:
    taken = _seen_experiment("cam_beam", tmp_path)
    angles = taken.footage.angles.copy()
    angles[[100, 200, 201]] += 0.05
    record = video_record.joined(
        replace(taken.footage, angles=angles), taken.layers, taken.rig, taken.bag, exposure=0.008
    )
    assert np.flatnonzero(record.filled).tolist() == [100, 200, 201]
    assert any("3 of" in line and "sensor" in line for line in record.footage.remarks())


def test_a_film_without_a_bag_says_that_nothing_tells_the_size_of_its_angles(wheel: SeenExperiment) -> None:
    """Seen from 20 degrees beside the axis, angles are 6 % too large, and no residual shows it."""
    record = video_record.joined(wheel.footage, wheel.layers, wheel.rig, None, exposure=0.008)
    assert any("the film alone tells how large" in line for line in video_record.contradictions(record))


def test_a_film_without_a_bag_begins_in_the_turn_about_zero(wheel: SeenExperiment) -> None:
    """-.1 rad reads as 6.18 where angles go round."""
    layers = replace(wheel.layers, geometry=replace(wheel.layers.geometry, low=0.0, high=2.0 * np.pi, zero=0.0))
    angles = wheel.footage.angles - wheel.footage.angles[0] + 2.0 * np.pi - 0.1
    record = video_record.joined(replace(wheel.footage, angles=angles), layers, wheel.rig, None, exposure=0.008)
    assert record.positions[0] == pytest.approx(-0.1)


@pytest.mark.parametrize(("jump", "hangs"), [(0.0, False), (0.02, True)])
def test_equal_pictures_are_a_camera_that_hangs_only_where_the_joint_jumps(jump: float, hangs: bool) -> None:
    """A codec repeats its picture while the joint rests."""
    same, angles = np.zeros(40, dtype=bool), 0.01 * np.sin(np.arange(40.0))
    same[10:30], angles[9:30], angles[30:] = True, angles[9], angles[9] + jump
    found = frozen_pictures(same, angles, reach=150.0)
    assert found.any() == hangs
    assert not hangs or found.sum() == 19


@pytest.mark.parametrize("hangs", [False, True])
def test_a_joint_that_stands_hangs_where_it_goes_on_farther_than_it_ever_speeds_up(hangs: bool) -> None:
    """Whatever a codec makes of the picture: of a swing that speeds up by .75 pixels from one picture to the next,
    and begins anew from rest, or goes on as if nothing had been.
    """
    places: Array = 12.0 * np.sin(0.25 * np.arange(120))
    places[40:60] = places[40] + 0.05 * np.random.default_rng(0).standard_normal(20)
    if not hangs:
        places[60:] = places[59] + 12.0 * (1.0 - np.cos(0.25 * np.arange(60)))
    found = frozen_pictures(np.zeros(120, dtype=bool), places / 150.0, reach=150.0)
    assert np.flatnonzero(found).tolist() == (list(range(42, 60)) if hangs else [])


@pytest.mark.parametrize("every", [2, 3, 5])
def test_copies_are_pictures_in_which_a_joint_stands_that_goes_on_before_and_after(every: int) -> None:
    """As a film has that was written at a higher rate than it was taken at, or lost one; a joint that rests, or turns
    back, has none.
    """
    noise = 0.02 * np.random.default_rng(0).standard_normal(240)
    places = 30.0 * np.sin(2.0 * np.pi * 0.8 * np.arange(240) / 30.0) + noise
    places[100:130] = places[100] + noise[100:130]
    speed = np.abs(np.diff(places, prepend=places[0]))
    assert not copied_pictures(places).any()
    copy = np.arange(240) % every == every - 1
    copied = copied_pictures(np.where(copy, np.roll(places, 1), places))
    assert copied[~copy].mean() < 0.1
    assert copied[copy & (speed > 2.0)].mean() > 0.8
    once = places.copy()
    once[60] = once[59]
    assert np.flatnonzero(copied_pictures(once)).tolist() == [60]


def test_pictures_of_somebody_who_walks_by_leap_and_a_joint_that_steps_or_swings_does_not() -> None:
    times = np.arange(300) / 30.0
    swings = np.radians(6.0) * np.sin(2.0 * np.pi * 1.3 * times)
    steps = np.radians(6.0) * np.sign(np.sin(2.0 * np.pi * 0.3 * times))
    fast = np.radians(6.0) * np.sin(2.0 * np.pi * 6.3 * times)
    both = swings + 0.5 * fast
    for sound in (swings, steps, fast, both):
        assert not leaping_pictures(sound).any()
    for hidden in ([69], [74, 75], [120, 121, 122]):
        seen = swings.copy()
        seen[hidden] += np.radians(14.0) * np.where(swings[hidden] > 0.0, -1.0, 1.0)
        assert np.flatnonzero(leaping_pictures(seen)).tolist() == hidden
