"""A closed loop out of a bag: tracking, delays and missed commands are those that the bag was written with."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.report import closed_loop_section
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.support.errors import UserError
from tests import two_carts

RIG = rigs.load("cam_beam")
PERIOD = 5_000_000  # ns
START = 1_700_000_000_000_000_000  # ns
SAMPLES = 400
BEFORE = 10  # measurements before the reference begins
PREVIEW = 101  # points, one a period


def wanted(seconds):
    """The reference in volts: a step at 1 s."""
    return np.where(np.asarray(seconds) >= 1.0, 2.0, -1.0)


def logged(series, at):
    """The same messages, logged at other times than their stamps."""
    return dataclasses.replace(series, stamps=np.asarray(at, dtype=np.int64))


def write(path, *, error=0.0, delay=None, log=None, answered=None, start=START, every=10):
    """A loop: measurements at `start` + k PERIOD, logged 0.2 ms later; commands `delay` [ns] after the stamp.

    error: of the position [V]. log: what to add to all times of logging. answered: measurements with a command.
    every: periods between two references.
    """
    k = np.arange(SAMPLES)
    stamps = start + k * PERIOD
    delay = np.full(SAMPLES, 1_500_000) if delay is None else np.asarray(delay)
    answered = k if answered is None else np.asarray(answered)
    shift = 0 if log is None else log
    zero = stamps[BEFORE]
    positions = RIG.display[0].si(wanted((stamps - zero) * 1e-9) - error)
    effort = np.where(k == 0, np.nan, 0.01 * (k - 1))  # of the interval that ends at the stamp
    measured = bags.joint_states(
        "/cam_beam/joint_states", stamps, ["beam"], position=positions[:, None], effort=effort[:, None]
    )
    commands = bags.joint_states(
        "/cam_beam/joint_command", stamps[answered], ["beam"], effort=(0.01 * answered)[:, None]
    )
    begins = zero + np.arange(0, SAMPLES, every) * PERIOD
    ahead = np.arange(PREVIEW) * PERIOD
    previews = RIG.display[0].si(wanted((begins[:, None] + ahead - zero) * 1e-9))
    reference = bags.joint_trajectories(
        "/cam_beam/reference", begins, ["beam"], positions=previews[:, :, None], times=ahead * 1e-9
    )
    return bags.write_bag(
        path,
        [
            logged(measured, stamps + 200_000 + shift),
            logged(commands, (stamps + delay)[answered] + shift),
            logged(reference, begins + 300_000 + shift),
        ],
    )


def test_time_zero_is_the_stamp_of_the_first_reference(tmp_path):
    loop = LoopRecord.from_bag(write(tmp_path / "run"), RIG)
    assert loop.name == "run"
    assert len(loop.digest) == 64
    np.testing.assert_allclose(loop.time, 0.005 * (np.arange(SAMPLES) - BEFORE), atol=1e-12)
    np.testing.assert_array_equal(loop.stamps, START + np.arange(SAMPLES) * PERIOD)


def test_the_reference_at_a_stamp_is_the_preview_s(tmp_path):
    loop = LoopRecord.from_bag(write(tmp_path / "run"), RIG)
    assert np.isnan(loop.reference[:BEFORE]).all()
    np.testing.assert_allclose(RIG.display[0].shown(loop.reference[BEFORE:, 0]), wanted(loop.time[BEFORE:]), atol=1e-12)


def test_of_one_time_the_newest_preview_tells(tmp_path):
    stamps = START + np.arange(SAMPLES) * PERIOD
    zeros = np.zeros((SAMPLES, 1))
    begins = stamps[[0, 100]]
    positions = np.stack([np.full((150, 1), 0.1), np.full((150, 1), 0.2)])
    topics = [
        bags.joint_states("/cam_beam/joint_states", stamps, ["beam"], position=zeros, effort=zeros),
        bags.joint_states("/cam_beam/joint_command", stamps, ["beam"], effort=zeros),
        bags.joint_trajectories(
            "/cam_beam/reference", begins, ["beam"], positions=positions, times=0.005 * np.arange(150)
        ),
    ]
    loop = LoopRecord.from_bag(bags.write_bag(tmp_path / "run", topics), RIG)
    np.testing.assert_allclose(
        loop.reference[:, 0], np.where(np.arange(SAMPLES) < 100, 0.1, 0.2)
    )  # and the last one is held


def test_tracking_is_judged_in_volts_and_within_its_window(tmp_path):
    loop = LoopRecord.from_bag(write(tmp_path / "run", error=np.where(np.arange(SAMPLES) < 110, 0.3, 0.1)), RIG)
    assert loop.tracking_rmse(0.0, 0.5) == pytest.approx(0.3)
    assert loop.tracking_rmse(0.5, 2.0) == pytest.approx(0.1)
    with pytest.raises(UserError, match="no measurement with a reference from 30 to 50 s"):
        loop.tracking_rmse(30.0, 50.0)


def test_the_input_is_the_one_applied_from_a_stamp_on(tmp_path):
    loop = LoopRecord.from_bag(write(tmp_path / "run"), RIG)
    np.testing.assert_allclose(loop.inputs[:-1, 0], 0.01 * np.arange(SAMPLES - 1))
    np.testing.assert_allclose(loop.command[:, 0], 0.01 * np.arange(SAMPLES))


def test_delays_are_those_of_the_commands(tmp_path):
    delay = np.random.default_rng(0).permutation(np.linspace(1_000_000, 3_000_000, SAMPLES).astype(int))
    loop = LoopRecord.from_bag(write(tmp_path / "run", delay=delay), RIG)
    np.testing.assert_allclose(loop.delay, 1e-9 * delay, rtol=1e-9)
    np.testing.assert_allclose(loop.turnaround, 1e-9 * (delay - 200_000), rtol=1e-9)
    found = loop.delays()
    assert found.p50 == pytest.approx(1e-9 * np.percentile(delay[BEFORE:], 50))
    assert found.p99 == pytest.approx(1e-9 * np.percentile(delay[BEFORE:], 99))
    assert found.max == pytest.approx(1e-9 * np.max(delay[BEFORE:]))
    assert loop.missed_commands() == 0


def test_a_command_is_missed_if_the_next_measurement_is_there_first(tmp_path):
    delay = np.full(SAMPLES, 1_500_000)
    delay[50] = PERIOD + 250_000  # after the next measurement, logged 0.2 ms after its stamp
    delay[60] = PERIOD + 150_000  # just in time
    delay[3] = 2 * PERIOD  # before the reference began
    answered = np.delete(np.arange(SAMPLES), [200, SAMPLES - 1])  # the last one has no next measurement
    loop = LoopRecord.from_bag(write(tmp_path / "run", delay=delay, answered=answered), RIG)
    np.testing.assert_array_equal(np.flatnonzero(loop.late), [3, 50, 200])
    assert loop.missed_commands() == 2
    assert loop.missed_commands(-1.0) == 3
    assert np.isnan(loop.delay[200])
    assert np.isnan(loop.command[200])


def test_in_simulated_time_only_the_turnaround_means_something(tmp_path):
    bag = write(tmp_path / "run", start=1_000_000_000, log=START)
    loop = LoopRecord.from_bag(bag, RIG)
    assert not loop.is_real_time
    assert np.isnan(loop.delays().p99)
    assert loop.turnarounds().p50 == pytest.approx(1.3e-3)
    assert loop.missed_commands() == 0


def test_in_simulated_time_a_command_is_missed_only_if_none_came(tmp_path):
    delay = np.full(SAMPLES, PERIOD + 250_000)  # the recorder may get the next measurement first
    answered = np.delete(np.arange(SAMPLES), 200)
    bag = write(tmp_path / "run", start=1_000_000_000, log=START, delay=delay, answered=answered)
    np.testing.assert_array_equal(np.flatnonzero(LoopRecord.from_bag(bag, RIG).late), [200])


def test_a_repeated_measurement_counts_once(tmp_path):
    stamps = START + np.repeat(np.arange(SAMPLES), 2) * PERIOD
    zeros = np.zeros((2 * SAMPLES, 1))
    topics = [
        bags.joint_states("/cam_beam/joint_states", stamps, ["beam"], position=zeros, effort=zeros),
        bags.joint_states("/cam_beam/joint_command", stamps, ["beam"], effort=zeros),
        bags.joint_trajectories(
            "/cam_beam/reference", stamps[:1], ["beam"], positions=np.zeros((1, 1, 1)), times=[0.0]
        ),
    ]
    loop = LoopRecord.from_bag(bags.write_bag(tmp_path / "run", topics), RIG)
    assert len(loop.time) == SAMPLES


@pytest.mark.parametrize("missing", ["joint_states", "joint_command", "reference"])
def test_a_bag_without_a_topic_is_refused_by_name(tmp_path, missing):
    stamps = START + np.arange(SAMPLES) * PERIOD
    zeros = np.zeros((SAMPLES, 1))
    topics = {
        "joint_states": bags.joint_states("/cam_beam/joint_states", stamps, ["beam"], position=zeros, effort=zeros),
        "joint_command": bags.joint_states("/cam_beam/joint_command", stamps, ["beam"], effort=zeros),
        "reference": bags.joint_trajectories(
            "/cam_beam/reference", stamps, ["beam"], positions=zeros[:, :, None], times=[0.0]
        ),
    }
    bag = bags.write_bag(tmp_path / "run", [series for name, series in topics.items() if name != missing])
    with pytest.raises(UserError, match=f"no topic /cam_beam/{missing}"):
        LoopRecord.from_bag(bag, RIG)


def test_a_position_that_is_no_number_is_refused(tmp_path):
    error = np.zeros(SAMPLES)
    error[7] = np.nan
    with pytest.raises(UserError, match=r"joint_states: position\[beam\] is nan in message 7"):
        LoopRecord.from_bag(write(tmp_path / "run", error=error), RIG)


def test_two_runs_in_one_bag_are_refused(tmp_path):
    stamps = START + np.concatenate([np.arange(100), np.arange(100)]) * PERIOD
    zeros = np.zeros((200, 1))
    measured = bags.joint_states("/cam_beam/joint_states", stamps, ["beam"], position=zeros, effort=zeros)
    topics = [
        logged(measured, START + np.arange(200) * PERIOD),
        bags.joint_states("/cam_beam/joint_command", stamps[:100], ["beam"], effort=zeros[:100]),
        bags.joint_trajectories(
            "/cam_beam/reference", stamps[:1], ["beam"], positions=np.zeros((1, 1, 1)), times=[0.0]
        ),
    ]
    with pytest.raises(UserError, match="reversed stamp at message 100"):
        LoopRecord.from_bag(bags.write_bag(tmp_path / "run", topics), RIG)


def test_a_loop_of_two_inputs_and_two_outputs_stands_in_a_report(tmp_path):
    """200 mm and 50 mm wanted, 1 mm and 2 mm missed, of which one output is no joint's motion."""
    rig = rigs.load(two_carts.write(tmp_path / "looped_carts"))
    stamps = START + np.arange(SAMPLES) * PERIOD
    seconds = 0.005 * np.arange(SAMPLES)
    wanted = 1e-3 * rig.schedule()(seconds)
    measured = wanted - [1e-3, 2e-3]
    pushes = np.stack([np.full(SAMPLES, 5.0), np.linspace(-4.0, 4.0, SAMPLES)], axis=1)
    none = np.full(SAMPLES, np.nan)
    names = ["cart", "gap", "right_push"]
    joints = bags.joint_states(
        "/looped_carts/joint_states",
        stamps,
        names,
        position=np.stack([measured[:, 0], measured[:, 1], none], axis=1),
        effort=np.stack([pushes[:, 0], none, pushes[:, 1]], axis=1),
    )
    commands = bags.joint_states("/looped_carts/joint_command", stamps, ["cart", "right_push"], effort=pushes)
    reference = bags.joint_trajectories(
        "/looped_carts/reference", stamps, ["gap", "cart"], positions=wanted[:, None, ::-1], times=[0.0]
    )
    loop = LoopRecord.from_bag(bags.write_bag(tmp_path / "run", [joints, commands, reference]), rig)
    assert loop.tracked == [0, 1]
    np.testing.assert_allclose(loop.outputs, measured)
    np.testing.assert_allclose(loop.reference, wanted, atol=1e-12)
    np.testing.assert_allclose(loop.inputs[:-1], pushes[1:])
    np.testing.assert_allclose(loop.command, pushes)
    assert loop.tracking_rmse(output=1) == pytest.approx(2.0)  # mm
    section = closed_loop_section(loop)
    loop_figures = pytest.importorskip("hybrid_sysid_ros.extensions.shared.report.loop_figures")
    assert section.rmse == pytest.approx({"out": 1.0, "apart": 2.0})
    assert section.units == {"out": "mm", "apart": "mm"}
    for figure in (loop_figures.tracking(section), loop_figures.zoom(section, section.windows["apart"])):
        titles = {axis.title.text for axis in figure.select_yaxes() if axis.title.text}
        assert {"gap [mm]", "left_push [N]", "right_push [N]"} <= titles
