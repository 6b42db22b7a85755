"""Times of other programs become the even ones of a record."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.importing.tests.tables import (
    DRIVE,
    POSITION,
    TIME,
    assert_same,
    read,
    status_of,
    table,
)
from tests.command_line import refused


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("Horodatage", "%Y-%m-%dT%H:%M:%S.%f+02:00"),
        ("Zeitstempel", "%d.%m.%Y %H:%M:%S,%f"),
        ("data e ora", "%d/%m/%Y %H:%M:%S.%f"),
        ("When", "%m/%d/%Y %I:%M:%S.%f %p"),
        ("Uhrzeit", "%H:%M:%S.%f"),
    ],
)
def test_dates_are_times_whatever_their_column_is_called(imported, tmp_path, name, form):
    """The moments pass the end of March, whose days are told from months by the record's length."""
    first = datetime(2024, 3, 3, 11, 59, 58)
    rows = [
        f"{(first + timedelta(seconds=time)).strftime(form)};{drive};{position}"
        for time, drive, position in zip(TIME.tolist(), DRIVE, POSITION, strict=True)
    ]
    (tmp_path / "log.csv").write_text("\n".join([f"{name};drive;position", *rows]))
    assert "one in 0.01 s" in status_of(imported(str(tmp_path / "log.csv")))
    assert_same(read(tmp_path))


def test_zones_of_dates_count(imported, tmp_path):
    """In the night in which summer time begins, 02:00 of the winter's zone is 03:00 of the summer's."""
    stamps = [f"2023-03-26T{'01:59:' if k < 200 else '03:00:'}{(58 + 0.01 * k) % 60:05.2f}" for k in range(400)]
    rows = [f"{stamp}{'+01:00' if k < 200 else '+02:00'},{DRIVE[k]},{POSITION[k]}" for k, stamp in enumerate(stamps)]
    (tmp_path / "log.csv").write_text("\n".join(["when,drive,position", *rows]))
    assert "400 samples, 3.99 s" in status_of(imported(str(tmp_path / "log.csv")))
    assert_same(read(tmp_path))


@pytest.mark.parametrize(
    ("header", "factor", "first"),
    [("t_motor;unixtime;drive;position_mrad", 1.0, 1.7e9), ("t_motor;stamp;drive_mV;position_mrad", 1e9, 1.7e18)],
)
def test_units_that_end_names_and_counts_since_1970_are_read(imported, tmp_path, header, factor, first):
    """A temperature whose name begins with t is no time."""
    stamps = [str(int(first) + round(time * factor)) if factor > 1.0 else f"{first + time:.2f}" for time in TIME]
    volts = 1000.0 if "mV" in header else 1.0
    rows = [
        f"{40.0 + k % 7};{stamp};{volts * DRIVE[k]:.6f};{1000.0 * POSITION[k]:.6f}" for k, stamp in enumerate(stamps)
    ]
    (tmp_path / "log.csv").write_text("\n".join([header, *rows]))
    assert "one in 0.01 s" in status_of(imported(str(tmp_path / "log.csv")))
    assert_same(read(tmp_path))


@pytest.mark.parametrize(("name", "first"), [("Date", 45000.0), ("time", 738000.0)])
def test_days_of_spreadsheets_and_of_matlab_are_days(imported, tmp_path, name, first):
    """Of 1 s a row, which rounds to nine digits of a day."""
    file = table(tmp_path / "log.csv", f"{name},drive,position", first + 100.0 * TIME / 86400.0, DRIVE, POSITION,
                 form="%.12f")  # fmt: skip
    assert "one in 1 s" in status_of(imported(file))


def test_times_of_day_go_on_over_midnight(imported, tmp_path):
    first = datetime(2024, 3, 3, 23, 59, 58)
    stamps = [(first + timedelta(seconds=time)).strftime("%H:%M:%S.%f") for time in TIME.tolist()]
    rows = [f"{stamp};{drive};{position}" for stamp, drive, position in zip(stamps, DRIVE, POSITION, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["Uhrzeit;drive;position", *rows]))
    assert "one in 0.01 s" in status_of(imported(str(tmp_path / "log.csv")))
    assert_same(read(tmp_path))


def test_a_slow_output_is_sampled_where_it_was_measured(imported, tmp_path):
    """Beside an input in each row, whose means between two measurements act."""
    slow = np.where(np.arange(400) % 4 == 0, POSITION, np.nan)
    said = status_of(imported(table(tmp_path / "log.csv", "time,drive,position", TIME, DRIVE, slow)))
    assert "position comes only every 0.04 s" in said
    record = read(tmp_path)
    assert record.sampling_time == pytest.approx(0.04)
    assert record.measured is None or record.measured.all()
    np.testing.assert_allclose(record.output[:, 0], POSITION[::4], atol=1e-9)
    np.testing.assert_allclose(record.input[:-1, 0], DRIVE.reshape(-1, 4).mean(axis=1)[:-1], atol=1e-9)


def test_a_column_that_rises_is_named_where_no_name_says_time(imported, tmp_path):
    file = table(tmp_path / "log.csv", "row,drive,position", np.arange(400), DRIVE, POSITION)
    refused(imported(file), "row rises throughout", "--column time=row")


@pytest.mark.parametrize(
    ("header", "times"),
    [("ts,drive,position", 1.7e9 + TIME), ("dt [ms],drive,position", np.full(400, 10.0))],
    ids=["times", "sampling time"],
)
def test_a_sampling_time_in_each_row_is_told_from_times(imported, tmp_path, header, times):
    assert "one in 0.01 s" in status_of(imported(table(tmp_path / "log.csv", header, times, DRIVE, POSITION)))


def test_a_long_gap_makes_two_records(imported, tmp_path):
    rows = np.concatenate([np.arange(150), np.arange(250, 400)])
    file = table(tmp_path / "log.csv", "time,drive,position", TIME[rows], DRIVE[rows], POSITION[rows])
    assert "into 2 records" in status_of(imported(file))
    np.testing.assert_allclose(read(tmp_path, "log_2").output[:, 0], POSITION[250:], atol=1e-9)


def test_a_gap_of_no_whole_samples_does_not_make_the_times_uneven(imported, tmp_path):
    behind = TIME + np.where(np.arange(400) < 200, 0.0, 0.025)
    said = status_of(imported(table(tmp_path / "log.csv", "time,u,position", behind, DRIVE, POSITION)))
    assert "a gap is no whole number of samples" in said
    assert "uneven" not in said


def test_uneven_times_are_interpolated_and_coarse_ones_spread(imported, tmp_path):
    uneven = np.cumsum(np.random.default_rng(0).uniform(0.004, 0.016, 400))
    output = 0.05 * np.sin(3.0 * uneven)
    assert "uneven" in status_of(imported(table(tmp_path / "log.csv", "time,u,position", uneven, DRIVE, output)))
    record = read(tmp_path)
    exact = 0.05 * np.sin(3.0 * (record.time + uneven[0]))
    assert np.abs(record.output[:, 0] - exact)[5:-5].max() < 5e-4
    coarse = np.floor(TIME / 0.04) * 0.04
    assert "spread evenly" in status_of(
        imported(table(tmp_path / "second.csv", "time,u,position", coarse, DRIVE, POSITION))
    )
    assert_same(read(tmp_path, "second"))


def test_a_column_has_its_own_late_and_drifting_clock(imported, tmp_path):
    """Its stamp is late by 30 ms, and its clock is fast by a thousandth."""
    file = table(tmp_path / "log.csv", "t,u,t2,y", TIME, DRIVE, 1.001 * TIME + 0.03, POSITION)
    mapping = tmp_path / "clock.yaml"
    mapping.write_text(
        "time: {column: t2}\ninputs: {drive: {column: u, time: t, delay: -0.03, drift: -9.99000999e-4}}\n"
        "outputs: {position: {column: y}}\n"
    )
    status_of(imported(file, "--mapping", str(mapping)))
    record = read(tmp_path)
    np.testing.assert_allclose(record.output[:390, 0], POSITION[:390], atol=1e-6)
    assert np.mean(np.abs(record.input[:390, 0] - DRIVE[:390]) < 1e-3) > 0.95


@pytest.mark.parametrize(("name", "unit"), [("time", 1.0), ("time [ms]", 1000.0)])
def test_each_of_two_devices_keeps_its_own_times(imported, tmp_path, name, unit):
    """The second device began 50 ms later, and counts in its own unit."""
    table(tmp_path / "plc.csv", "time,drive", TIME, DRIVE)
    table(tmp_path / "daq.csv", f"{name},position", unit * TIME[5:], POSITION[5:])
    status_of(imported(str(tmp_path / "plc.csv"), "--also", str(tmp_path / "daq.csv")))
    record = read(tmp_path, "plc")
    np.testing.assert_allclose(record.output[:, 0], POSITION[5:], atol=1e-9)
    np.testing.assert_allclose(record.input[:394, 0], DRIVE[5:399], atol=1e-9)


def dated(path, *, first=datetime(2024, 3, 3, 11, 59, 58)):
    """Written with dates, from which a mapping has seconds."""
    stamps = [(first + timedelta(seconds=time)).isoformat(timespec="milliseconds") for time in TIME.tolist()]
    rows = [f"{stamp},{drive},{position}" for stamp, drive, position in zip(stamps, DRIVE, POSITION, strict=True)]
    path.write_text("\n".join(["stamp,drive,position", *rows]))
    return str(path)


@pytest.mark.parametrize(
    ("first", "words"), [(0.0, "seems to be in us, which is one sample in 0.01 s"), (1.7e9, "counts us since 1970")]
)
def test_counts_of_another_file_are_not_read_in_the_unit_of_its_dates(imported, tmp_path, first, words):
    """One sample in 10 000 s, of a rig whose fits have one in 50 ms."""
    status_of(imported(dated(tmp_path / "log.csv")))
    counts = table(tmp_path / "more.csv", "stamp,drive,position", 1e6 * (first + TIME), DRIVE, POSITION, form="%.0f")
    refused(imported(counts), words, "--unit time=")
    seconds = table(tmp_path / "seconds.csv", "stamp,drive,position", TIME, DRIVE, POSITION)
    assert "one in 0.01 s" in status_of(imported(seconds))


def test_counts_that_nobody_says_a_unit_of_are_not_seconds_of_a_faster_rig(imported, tmp_path):
    file = table(tmp_path / "log.csv", "stamp,drive,position", 1e6 * TIME, DRIVE, POSITION, form="%.3f")
    refused(imported(file), "stamp seems to be in us", "--unit time=")
    assert "one in 0.01 s" in status_of(imported(file, "--unit", "time=us"))
