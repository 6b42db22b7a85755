"""The public record of a drill string: read, cleaned of its spikes, and refused where that can't be."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.io import savemat

from hybrid_sysid_ros.support.errors import UserError
from studies.drill_string import __main__ as study
from studies.drill_string.records import ABOUT, RPM, cleaned, load
from tests.command_line import refused

PERIOD = 0.001


def top_speed(spikes=(), width=0.02, samples=6000):
    """A top at 80 rpm that swings by 30 rpm at 2.7 Hz; each spike is a half sine of that width [s] down to -200 rpm."""
    time = PERIOD * np.arange(samples)
    truth = RPM * (80.0 + 30.0 * np.sin(2 * np.pi * 2.7 * time))
    shown = truth.copy()
    for start in spikes:
        inside = (time >= start) & (time < start + width)
        depth = np.sin(np.pi * (time[inside] - start) / width)
        shown[inside] -= depth * (RPM * 200.0 + truth[inside])
    return truth, shown


def test_negative_spikes_go_with_their_flanks_and_nothing_else_does():
    truth, shown = top_speed(spikes=(1.0, 2.5, 4.2))
    clean, found = cleaned(shown, PERIOD)
    assert (found.spikes, found.lowest < -RPM * 190.0) == (3, True)
    assert found.negative == np.sum(shown < 0)
    assert found.replaced == pytest.approx(3 * 0.02 / 6.0, rel=0.3)
    assert clean.min() > -RPM * 10.0
    near = np.convolve(shown != truth, np.ones(2 * round(ABOUT / PERIOD) + 21), "same") > 0.0
    np.testing.assert_array_equal(clean[~near], truth[~near])


def test_the_top_turns_as_far_as_its_sensor_tells():
    clean, found = cleaned(top_speed(spikes=(1.0, 2.5, 2.53, 4.2))[1], PERIOD)
    shown = top_speed(spikes=(1.0, 2.5, 2.53, 4.2))[1]
    assert PERIOD * clean.sum() == pytest.approx(PERIOD * shown.sum(), abs=1e-9)
    assert found.returned > 1.0


def test_a_top_that_stands_does_so_between_spikes_that_add_up_to_nothing():
    """Of every 40 ms the sensor tells +4 rad/s for 30 and -12 for 10, as it does in the long stops of the record."""
    time = PERIOD * np.arange(4000)
    stands = (time >= 1.0) & (time < 2.0)
    shown = np.where(stands, np.where(time % 0.04 < 0.0299, 4.0, -12.0), 8.0)
    clean, _ = cleaned(shown, PERIOD)
    inside = (time >= 1.1) & (time < 1.9)
    assert np.max(np.abs(clean[inside])) < 0.5


def test_a_record_without_spikes_stays_as_it_is():
    truth, shown = top_speed()
    clean, found = cleaned(shown, PERIOD)
    np.testing.assert_array_equal(clean, truth)
    assert (found.spikes, found.replaced) == (0, 0.0)


def test_spikes_beyond_cleaning_are_counted_and_placed():
    many = np.arange(0.05, 5.9, 0.06)
    with pytest.raises(
        UserError, match=rf"{len(many)} negative spikes, .* % of the samples, .* at most 15 % and 0.25 s"
    ):
        cleaned(top_speed(spikes=many)[1], PERIOD)
    with pytest.raises(UserError, match=r"1 negative spikes, .* the longest of 0\.\d+ s at 2\.0\d+ s"):
        cleaned(top_speed(spikes=(2.0,), width=0.4)[1], PERIOD)


def written(folder, **changes):
    """A file as the record's."""
    shown = top_speed(spikes=(1.0,))[1] / RPM
    channels = {"Time": PERIOD * np.arange(6000), "Top_Speed": shown, "Bit_Speed": shown, "Bit_Torque": shown}
    content = {f"{name}_Sample_175_complete": value[:, None] for name, value in {**channels, **changes}.items()}
    savemat(folder / "175_completo_1.mat", content)


def test_a_record_is_read_in_si(tmp_path):
    written(tmp_path)
    record, found = load(tmp_path)
    assert record.sampling_time == pytest.approx(PERIOD)
    assert record.input.shape == (6000, 1)
    np.testing.assert_allclose(record.output[:, 0], RPM * record.output[:, 1])
    assert found.spikes == 1
    again, _ = load(tmp_path / "175_completo_1.mat")
    np.testing.assert_array_equal(again.output, record.output)


def test_what_is_no_such_record_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"no 175_completo_1\.mat"):
        load(tmp_path)
    written(tmp_path, Bit_Speed=np.zeros(10))
    with pytest.raises(UserError, match="different numbers of samples"):
        load(tmp_path)
    written(tmp_path, Bit_Torque=np.where(np.arange(6000) == 70, np.nan, 1.0))
    with pytest.raises(UserError, match="Bit_Torque is not finite at sample 70, 1 of 6000 are not; fetch it again"):
        load(tmp_path)
    for channel in ("Top_Speed", "Bit_Speed"):
        written(tmp_path, **{channel: top_speed()[1]})  # in rad/s
        with pytest.raises(UserError, match=r"Top_Speed turns by [\d.]+ rad, Bit_Speed by [\d.]+ rad, .* in rpm"):
            load(tmp_path)
    written(tmp_path, Time=np.where(np.arange(6000) == 70, 0.0, PERIOD * np.arange(6000)))
    with pytest.raises(UserError, match=r"Time is no 4 s in even steps"):
        load(tmp_path)
    written(tmp_path, **dict.fromkeys(("Time", "Top_Speed", "Bit_Speed", "Bit_Torque"), PERIOD * np.arange(900)))
    with pytest.raises(UserError, match=r"Time is no 4 s in even steps"):
        load(tmp_path)
    savemat(tmp_path / "175_completo_1.mat", {"Time_Sample_1": np.arange(5.0)})
    with pytest.raises(UserError, match="has no Top_Speed_Sample"):
        load(tmp_path)
    (tmp_path / "175_completo_1.mat").write_bytes(b"no such file")
    with pytest.raises(UserError, match=r"is no readable \.mat file"):
        load(tmp_path)


@pytest.mark.parametrize("place", ["file/x.json", "/proc/x.json", "taken", "numbers.txt"])
def test_the_study_says_where_it_cannot_write_before_anything_else(call, tmp_path, place):
    (tmp_path / "file").touch()
    (tmp_path / "taken").mkdir()
    command = partial(call, study.main, "python -m studies.drill_string")
    refused(command("record", tmp_path / "nowhere", "--out", tmp_path / place), place)
    refused(command("choose", tmp_path, "--seed", "-1"), "--seed")
