"""What a record says that its rig has hardly done: inputs beyond its actuators, spikes, another unit."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from hybrid_sysid_ros.bags import joint_states, read, write_bag
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.plausibility import check_limits, spikes, strangeness
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError
from tests.command_line import refused
from tests.test_cli import BAGS

RPM = 60.0 / (2.0 * np.pi)
DRILL, WHEEL, JOINT = ("drill_string", "wheel_motor", "flexible_joint")


def record_of(rig, kind="random_steps", *, torque=1.0, outputs=1.0):
    """A shipped bag, its input and outputs scaled."""
    found = read(BAGS / f"{rig}_{kind}", load_rig(rig).signals)
    return replace(found, input=torque * found.input, output=found.output * outputs)


def with_spikes(record, samples, value, column):
    outputs = record.output.copy()
    outputs[samples, column] = value
    return replace(record, output=outputs)


@pytest.mark.parametrize("path", sorted(path.name for path in BAGS.iterdir() if path.is_dir()))
def test_nothing_is_said_of_the_shipped_bags(path):
    rig = load_rig({"beam": "cam_beam"}.get(path.split("_")[0], "_".join(path.split("_")[:2])))
    record = read(BAGS / path, rig.signals)
    check_limits(record, rig, rig.signals)
    assert spikes(record, rig, rig.signals) == []
    assert strangeness(record, load_model(shipped(rig.name, "model")), rig, rig.signals) == []


def test_an_input_that_no_actuator_gives_is_refused_with_field_sample_and_count():
    """Newton millimetres: 2.56 N m are 2560."""
    rig, record = load_rig(DRILL), record_of(DRILL, torque=1000.0)
    with pytest.raises(UserError) as raised:
        check_limits(record, rig, rig.signals)
    reported, count = str(raised.value), int(np.sum(np.abs(record.input) > 6.0))
    assert f"effort[top]: input torque goes to {record.input[np.argmax(np.abs(record.input)), 0]:.6g} N m" in reported
    assert f"{count} of {record.samples} samples" in reported
    assert "\n" not in reported


def test_an_input_that_noise_carries_a_little_past_its_limit_is_none():
    rig, record = load_rig(DRILL), record_of(DRILL)
    noise = np.random.default_rng(0).normal(0.0, 0.3, record.input.shape)
    check_limits(replace(record, input=np.clip(10.0 * record.input, -3.0, 3.0) + noise), rig, rig.signals)


def test_spikes_are_counted_and_placed():
    rig = load_rig(DRILL)
    record = with_spikes(record_of(DRILL), [100, 101, 700, 1500], -60.0, 1)
    (reported,) = spikes(with_spikes(record, [701], -90.0, 1), rig, rig.signals)
    assert "velocity[top]: output top_speed has 3 spikes, the first at sample 100 (2 s)" in reported
    assert "the farthest to -90 rad/s at sample 701 (14.02 s)" in reported


def test_spikes_at_either_end_are_some_too():
    rig = load_rig(DRILL)
    (reported,) = spikes(with_spikes(record_of(DRILL), [0, 1000, 2000], -60.0, 1), rig, rig.signals)
    assert "has 3 spikes, the first at sample 0 (0 s)" in reported


@pytest.mark.parametrize("seed", range(3))
def test_steps_rest_ringing_and_a_coarse_encoder_are_no_spikes(seed):
    rig, bag = load_rig(WHEEL), record_of(WHEEL)
    random, time = np.random.default_rng(seed), bag.time
    shapes = {
        "steps": np.sign(np.sin(7.0 * time)),
        "rest": np.where((time > 5.0) & (time < 5.3), 1.0, 0.0),
        "ringing": np.exp(-8.0 * time) * np.cos(60.0 * time),
        "fast": np.sin(2.0 * np.pi * time / (3.0 * bag.sampling_time)),
        "coarse": np.round(np.sin(time) + random.normal(0.0, 0.2, len(time))),
        "drift": np.cumsum(random.normal(size=len(time))),
    }
    for shape in shapes.values():
        noisy = shape + random.normal(0.0, 0.02, len(time))
        assert spikes(replace(bag, output=noisy[:, None]), rig, rig.signals) == []


@pytest.mark.parametrize(
    ("rig", "scale", "reported"),
    [
        (DRILL, RPM, ["bit_speed", "top_speed"]),
        (WHEEL, RPM, ["speed"]),
        (JOINT, np.array([180.0 / np.pi, 1.0]), ["motor_angle"]),
        (JOINT, np.array([1.0, RPM]), ["link_speed"]),
    ],
)
def test_outputs_in_another_unit_than_the_model_s_are_named(rig, scale, reported):
    known = load_rig(rig)
    found = strangeness(record_of(rig, outputs=scale), load_model(shipped(rig, "model")), known, known.signals)
    units = {item.name: item.unit for item in known.system.outputs}
    assert len(found) == len(reported)
    for line, name in zip(found, reported, strict=True):
        assert f"]: {name} goes to " in line
        assert f"is it in {units[name]}?" in line


@pytest.fixture
def command(call):
    """Run hybrid-sysid with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid")


def written(path, record):
    """A bag of a record of the wheel's motor."""
    stamps = np.round(1e9 * (1.0 + record.time)).astype(np.int64)
    effort = np.concatenate([[[np.nan]], record.input[:-1]])  # of the interval before
    return write_bag(
        path, [joint_states("/wheel_motor/joint_states", stamps, ["wheel"], velocity=record.output, effort=effort)]
    )


FIT = ("--rig", WHEEL, "--structure", "gray", "--step", "0.005", "--period", "0.01")


def test_a_bag_whose_input_no_actuator_gives_gets_one_line_by_every_command(command, tmp_path):
    """Parts per thousand of the supply in place of counts."""
    bag = written(tmp_path / "bag", record_of(WHEEL, torque=4.0))
    words = bag, "topic /wheel_motor/joint_states: effort[wheel]", "-255 to 255 counts", "samples", "--signals"
    refused(command("identify", bag, *FIT, "--out", tmp_path / "model"), *words)
    refused(command("evaluate", shipped(WHEEL, "model"), bag), *words)


def test_a_bag_in_another_unit_is_reported_by_evaluate_and_before_a_fit(command, tmp_path):
    model, bag = shipped(WHEEL, "model"), written(tmp_path / "rpm", record_of(WHEEL, outputs=RPM))
    status, out, error = command("evaluate", model, bag, "--json")
    assert status == 0, error
    assert "doubt: " in error
    assert "is it in rad/s?" in error
    assert "rpm" in json.loads(out)["records"]
    bag = written(tmp_path / "share", record_of(WHEEL, torque=1.0 / 255.0))
    refused(command("identify", bag, *FIT, "--out", tmp_path / "model"), "no excitation", "another unit")
    status, out, error = command("identify", bag, *FIT, "--out", tmp_path / "model", "--anyway")
    assert status == 0, error
    assert "doubt: over share, which it was fitted to, R2 of its run is 0.0" in out


def test_a_bag_with_spikes_is_reported_by_identify(command, tmp_path):
    bag = written(tmp_path / "bag", with_spikes(record_of(WHEEL), [400, 800], 300.0, 0))
    status, _, error = command("identify", bag, *FIT, "--out", tmp_path / "model")
    assert status == 0, error
    assert "velocity[wheel]: output speed has 2 spikes, the first at sample 400 (4 s)" in error
