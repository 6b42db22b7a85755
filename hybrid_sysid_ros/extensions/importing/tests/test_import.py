"""Text files of other programs become the record that they hold."""

from __future__ import annotations

from datetime import datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.importing.log_file import unit_at_end, words_of
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.units import Unit, named
from tests.command_line import Answer, refused

TIME = 0.01 * np.arange(400)
DRIVE = np.round(5.0 * np.sign(np.sin(3.0 * TIME)) + 0.01 * np.arange(400) / 400, 6)
POSITION = np.round(0.05 * np.sin(3.0 * TIME), 6)
"""rad."""


@pytest.fixture
def program(call):
    return partial(call, app.main, "hybrid-sysid")


@pytest.fixture
def imported(call, tmp_path):
    return partial(call, app.main, "hybrid-sysid", "import", "--rig", "cam_beam", "--out", str(tmp_path / "bags"))


def table(path: Path, header: str, *columns, delimiter=",", comma=False, form="%.6f") -> str:
    rows = [
        delimiter.join(form % value if np.isfinite(value) else "" for value in row)
        for row in zip(*columns, strict=True)
    ]
    text = "\n".join(row.replace(".", ",") if comma else row for row in rows)
    path.write_text(f"{header}\n{text}\n", encoding="cp1252")
    return str(path)


def read(folder: Path, name: str = "log"):
    return bags.read(folder / "bags" / name, rigs.load("cam_beam").signals)


def assert_same(record, output=POSITION, samples=400):
    assert record.samples == samples
    np.testing.assert_allclose(record.output[:, 0], output, atol=1e-9)
    np.testing.assert_allclose(record.input[: samples - 1, 0], DRIVE[: samples - 1], atol=1e-9)


def status_of(answer: Answer) -> str:
    status, out, error = answer
    assert status == 0, error
    return out + error


@pytest.mark.parametrize(
    ("header", "delimiter", "comma", "unit"),
    [
        ("time,drive,position", ",", False, 1.0),
        ("time [ms];drive [V];position [mrad]", ";", False, 1000.0),
        ("Made by a logger\nt;u;pos\nms;V;mrad", ";", True, 1000.0),
        ("# time drive position", " ", False, 1.0),
        ("t_ms\tU\tangle (mrad)", "\t", True, 1000.0),
        ("time drive position", " ", True, 1.0),
    ],
)
def test_names_units_delimiters_and_decimal_signs_are_found(imported, tmp_path, header, delimiter, comma, unit):
    file = table(tmp_path / "log.csv", header, unit * TIME, DRIVE, unit * POSITION, delimiter=delimiter, comma=comma)
    assert "one in 0.01 s" in status_of(imported(file))
    assert_same(read(tmp_path), samples=400)


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


@pytest.mark.parametrize("delimiter", [",", " "])
def test_on_and_off_are_one_and_zero(imported, tmp_path, delimiter):
    words = np.where(DRIVE > 0.0, "on", "OFF")
    rows = [delimiter.join((f"{t:.2f}", w, f"{y:.6f}")) for t, w, y in zip(TIME, words, POSITION, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([delimiter.join(("time", "drive", "position")), *rows]))
    status_of(imported(str(tmp_path / "log.csv")))
    np.testing.assert_array_equal(read(tmp_path).input[:-1, 0], (DRIVE > 0.0)[:-1])


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


@pytest.mark.parametrize("delimiter", [";", " "])
def test_text_of_two_bytes_a_letter_is_read(imported, tmp_path, delimiter):
    """As spreadsheets and LabVIEW save it."""
    header = delimiter.join(("time", "drive", "position"))
    plain = Path(table(tmp_path / "log.csv", header, TIME, DRIVE, POSITION, delimiter=delimiter, comma=True))
    plain.write_text(plain.read_text(), encoding="utf-16")
    status_of(imported(str(plain)))
    assert_same(read(tmp_path))


@pytest.mark.parametrize(
    ("header", "times"),
    [("ts,drive,position", 1.7e9 + TIME), ("dt [ms],drive,position", np.full(400, 10.0))],
    ids=["times", "sampling time"],
)
def test_a_sampling_time_in_each_row_is_told_from_times(imported, tmp_path, header, times):
    assert "one in 0.01 s" in status_of(imported(table(tmp_path / "log.csv", header, times, DRIVE, POSITION)))


def test_the_mapping_is_kept_and_used_again(imported, tmp_path):
    file = table(tmp_path / "log.csv", "a,b,c", TIME, DRIVE, POSITION)
    status, _, error = imported(file)
    assert status == 2
    assert error.count("\n") == error.count("error: ") == 3  # a line for each that is open
    assert "no column is a time" in error
    assert "which column is drive" in error
    chosen = ("--column", "time=a", "--column", "drive=b", "--column", "position=c")
    status_of(imported(file, *chosen))
    assert_same(read(tmp_path))
    other = table(tmp_path / "other.csv", "a,b,c", TIME, DRIVE, POSITION)
    assert "import.yaml says" in status_of(imported(other))
    assert_same(read(tmp_path, "other"))
    third = table(tmp_path / "third.csv", "a,b,c", TIME, DRIVE, POSITION)
    refused(imported(third, *chosen), "import.yaml", "exists already")  # and may be corrected by hand
    status_of(imported(third, *chosen, "--overwrite"))
    strange = table(tmp_path / "strange.csv", "t,x,y", TIME, DRIVE, POSITION)
    refused(imported(strange), "has no column a, b, c", "another rig")


def test_cells_without_a_number_are_missing_also_between_blanks(imported, tmp_path):
    rows = [f"{t:.2f} {u:.6f} {y:.6f}" for t, u, y in zip(TIME, DRIVE, POSITION, strict=True)]
    rows[50] = "0.50 - -"
    (tmp_path / "log.txt").write_text("time drive position\n" + "\n".join(rows))
    assert "1 of 400 values of position are missing" in status_of(imported(str(tmp_path / "log.txt")))
    assert list(np.flatnonzero(~read(tmp_path).measured)) == [50]


def test_doubled_missing_and_disordered_rows_are_repaired_by_name(imported, tmp_path):
    rows = np.concatenate([np.arange(100), [99, 100, 102, 101], np.arange(103, 200), np.arange(203, 400)])
    output = POSITION.copy()
    output[300] = np.nan
    file = table(tmp_path / "log.csv", "time,drive,position", TIME[rows], DRIVE[rows], output[rows])
    said = status_of(imported(file))
    for words in ("there twice", "go backwards", "1 gap, up to 0.04 s", "1 of"):
        assert words in said
    record = read(tmp_path)
    assert record.samples == 400
    assert list(np.flatnonzero(~record.measured)) == [200, 201, 202, 300]
    np.testing.assert_allclose(record.output[record.measured, 0], POSITION[record.measured], atol=1e-9)


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


def test_references_of_several_outputs_are_kept(call, tmp_path):
    file = table(
        tmp_path / "log.csv", "t,torque,motor_angle,link_speed,a,b", TIME, *(k * POSITION for k in range(1, 6))
    )
    options = ("--rig", "flexible_joint", "--out", str(tmp_path / "bags"))
    wanted = ("--column", "reference_motor_angle=a", "--column", "reference_link_speed=b")
    status_of(call(app.main, "hybrid-sysid", "import", file, *options, *wanted))
    channels = bags.read(tmp_path / "bags" / "log", rigs.load("flexible_joint").signals).channels
    np.testing.assert_allclose(channels["reference_motor_angle"], 4 * POSITION, atol=1e-6)
    np.testing.assert_allclose(channels["reference_link_speed"], 5 * POSITION, atol=1e-6)


@pytest.mark.parametrize(
    ("position", "words"),
    [
        ("{column: y}}\nchannels: {referense: {column: y}", ("channels.referense", "reference, filtered")),
        ("{column: y, shift: 1000}", ("shift of position is 1000", "400 rows")),
    ],
)
def test_a_mapping_that_asks_for_what_is_not_there_is_refused(imported, tmp_path, position, words):
    file, mapping = table(tmp_path / "log.csv", "t,u,y", TIME, DRIVE, POSITION), tmp_path / "import.yaml"
    mapping.write_text(f"time: {{column: t}}\ninputs: {{drive: {{column: u}}}}\noutputs: {{position: {position}}}\n")
    refused(imported(file, "--mapping", str(mapping)), *words)


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


@pytest.mark.parametrize(
    ("columns", "arguments", "words"),
    [
        ((TIME, DRIVE, POSITION), ("--unit", "position=kg"), ("position", "'kg'", "don't measure the same")),
        ((TIME, DRIVE, POSITION), ("--unit", "drive=kV"), ("drive goes to", "actuator")),
        ((TIME, DRIVE, 1000 * POSITION), (), ("position goes to", "travel")),
        ((TIME, DRIVE, POSITION), ("--column", "position=z"), ("no column 'z'",)),
        ((TIME, DRIVE, POSITION), ("--column", "speed=position"), ("'speed' is no signal",)),
        ((TIME, DRIVE, POSITION), ("--unit", "time=V"), ("unit of time",)),
        ((TIME[::-1], DRIVE, POSITION), (), ("go backwards",)),
        ((np.r_[TIME[:200], TIME[:200] - 5.0], DRIVE, POSITION), (), ("set back", "row 200")),
        ((np.tile(TIME[:200], 2), DRIVE, POSITION), (), ("another run", "row 200")),
        ((np.r_[TIME[:399], 1e9], DRIVE, POSITION), (), ("jumps by",)),
        ((np.repeat(TIME[:200] ** 2, 2), DRIVE, POSITION), (), ("twice, unevenly",)),
        ((TIME, np.full(400, np.nan), POSITION), (), ("holds no number",)),
        ((np.full(400, np.nan), DRIVE, POSITION), (), ("none of its 400 values is a number",)),
        ((TIME, DRIVE, POSITION), ("--unit", "time=ns"), ("no bag can hold", "another unit")),
        ((1e20 * TIME, DRIVE, POSITION), (), ("no bag can hold", "another unit")),
        ((TIME[:9], DRIVE[:9], POSITION[:9]), (), ("has 9 samples", "nowhere 20")),
    ],
)
def test_what_can_not_be_is_refused_in_a_line(imported, tmp_path, columns, arguments, words):
    file = table(tmp_path / "log.csv", "time,drive,position", *columns)
    refused(imported(file, *arguments), *words)
    assert not (tmp_path / "bags" / "log").exists()


def test_files_that_are_no_tables_are_refused(imported, tmp_path):
    for name, content, words in (
        ("a.csv", b"", "empty"), ("a.csv", b"\0\1\2" * 99, "no text file"),
        ("a.csv", b"hello\nworld\n", "no row of numbers"), ("a.xyz", b"1", "no known kind"),
        ("a.csv", b"t,u,y\n" + 9 * b"0,5,1,0,0,2\n", "6 values under 3 names"),
        ("a.csv", b"t;u;y\n" + 9 * b"0.5;1,000.25;0.2\n", "1,000.25 has a sign between its thousands"),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        refused(imported(str(tmp_path / name)), words)
    refused(imported(str(tmp_path / "missing.csv")), "no such file")


def test_a_file_larger_than_the_memory_is_refused_before_it_is_read(imported, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time,drive,position\n" + "0.00,1.00,0.01\n" * 20000)
    with path.open("r+b") as file:
        file.truncate(10 << 30)  # a hole, which takes no room
    refused(imported(str(path)), "GiB", "cut the file")


@pytest.mark.parametrize(
    ("name", "unit", "words"),
    [
        ("voltage_V", "V", ["voltage"]),
        ("U/V", "V", ["u"]),
        ("motor current A", "A", ["motor", "current"]),
        ("t / s", "s", ["t"]),
        ("tank pressure bar", "bar", ["tank", "pressure"]),
        ("speed_km/h", "km/h", ["speed"]),
        ("v m/s", "m/s", ["v"]),
        ("y_m", "", ["y", "m"]),
        ("sensor A", "", ["sensor", "a"]),
        ("voltage_m1", "", ["voltage", "m", "1"]),
        ("n/(1/min)", "", ["n"]),
        ("/imu/m", "", ["m"]),
        ("level_min", "", ["level", "min"]),
        ("omega_deg_s", "deg/s", ["omega"]),
        ("roll_rate_rad_s", "rad/s", ["roll", "rate"]),
        ("flow_l_min", "l/min", ["flow"]),
        ("T/K", "K", ["t"]),
        ("pump1_V", "V", ["pump", "1"]),
        ("room_degC", "degC", ["room"]),
        ("heater_percent", "percent", ["heater"]),
        ("x_s", "", ["x", "s"]),
        ("source_V", "V", ["source"]),
        ("cap_W", "W", ["cap"]),
        ("phase_V", "", ["phase", "v"]),
    ],
)
def test_a_unit_ends_a_name_where_the_name_says_what_it_measures(name, unit, words):
    assert unit_at_end(name) == unit
    assert words_of(name) == words


def test_units_of_industry_are_si():
    assert named("bar") == Unit("Pa", 0, 1e5)
    assert named("l/min") == Unit("m^3", 1, 1e-3 / 60)
    assert named("kmh") == named("km/h") == Unit("m", 1, 1 / 3.6)


def test_columns_are_known_as_the_header_writes_them(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "log.csv", "t [s],PWM [%],PWM [V],way [mm]", TIME, DRIVE, 0.1 * DRIVE, POSITION)
    for chosen in ("PWM [%]", "PWM"):
        made = program("rig", "from", "log.csv", f"./rig_{len(chosen)}", "--input", chosen, "--output", "way [mm]")
        assert "inputs: PWM; outputs: way" in status_of(made)
    made = program("rig", "from", "log.csv", "./other", "--input", "PWM [V]", "--output", "way")
    assert "inputs: PWM_2; outputs: way" in status_of(made)
    refused(program("rig", "from", "log.csv", "./none", "--input", "PWM [A]", "--output", "way"), "PWM [A]")


@pytest.mark.parametrize("name", ["Stellgröße", "pedal", "brake", "throttle", "u", "cmd", "duty"])
def test_a_rig_finds_its_input_by_name(program, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "log.csv", f"time,{name},quality,speed", TIME, DRIVE, 0.1 * DRIVE, POSITION)
    out = status_of(program("rig", "from", "log.csv", "./made"))
    assert f"inputs: {name}; outputs: speed" in out
