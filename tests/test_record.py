"""A record is checked when it is made, and cut by fractions of its duration."""

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.support.errors import UserError


def record(**changes):
    n = 101
    entries = {
        "name": "ms_05",
        "time": 0.001 * np.arange(n),
        "input": np.arange(n)[:, None],
        "output": -np.arange(n)[:, None],
        "channels": {"reference": 0.5 * np.arange(n)},
    }
    return Record(**{**entries, **changes})


def test_a_record_knows_its_sampling():
    assert record().sampling_time == pytest.approx(0.001, rel=1e-12)
    assert record().duration == pytest.approx(0.1, rel=1e-12)
    assert record().samples == 101
    assert record().input.dtype == np.float64


def test_two_halves_make_the_whole():
    first, second = record().part(0, 0.5), record().part(0.5, 1)
    assert first.samples + second.samples == 101
    assert np.array_equal(np.vstack([first.output, second.output]), record().output)
    assert np.array_equal(second.channels["reference"], 0.5 * second.input[:, 0])
    assert second.time[0] == 0
    assert second.sampling_time == pytest.approx(0.001, rel=1e-12)
    assert second.name == "ms_05"


def test_parts_are_cut_at_multiples_of_a_number_of_samples():
    assert [record().cut(fraction, 7) for fraction in (0, 0.5, 0.7, 1)] == [0, 49, 70, 101]
    first, second = record().part(0, 0.5, every=7), record().part(0.5, 1, every=7)
    assert first.samples == 49
    assert np.array_equal(np.vstack([first.output, second.output]), record().output)


@pytest.mark.parametrize(("start", "stop"), [(0.5, 0.5), (-0.1, 1), (0, 1.1), (0.7, 0.2), (float("nan"), 1), (0, 0.01)])
def test_a_part_that_is_none_is_refused(start, stop):
    with pytest.raises(UserError, match="record ms_05"):
        record().part(start, stop)


def with_entry(array, place, value):
    array = np.array(array, dtype=float)
    array[place] = value
    return array


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"output": np.zeros((100, 1))}, r"output has shape \(100, 1\)"),
        ({"input": np.zeros(101)}, r"input has shape \(101,\)"),
        ({"channels": {"filtered": np.zeros(7)}}, "channel filtered"),
        ({"output": with_entry(np.zeros((101, 1)), 17, np.nan)}, r"output is not finite at sample 17 \(0.017 s\)"),
        ({"input": with_entry(np.zeros((101, 1)), 3, np.inf)}, "input is not finite at sample 3"),
        ({"time": with_entry(0.001 * np.arange(101), 40, 0.0404)}, "not uniform at sample 40"),
        ({"time": with_entry(0.001 * np.arange(101), 9, np.nan)}, "time is not finite at sample 9"),
        ({"time": 1 + 0.001 * np.arange(101)}, "must start at 0"),
        ({"time": np.zeros(101)}, "must start at 0 and rise"),
        ({"time": np.zeros(1)}, "2 or more"),
    ],
)
def test_a_wrong_record_is_refused_with_its_name_and_sample(changes, reason):
    with pytest.raises(UserError, match=f"record ms_05.*{reason}"):
        record(**changes)


def test_a_channel_may_be_unknown_for_a_while():
    assert np.isnan(record(channels={"reference": np.full(101, np.nan)}).channels["reference"]).all()
