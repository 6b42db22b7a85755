"""Text files of other programs become the record that they hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.importing.log_file import unit_at_end, words_of
from hybrid_sysid_ros.extensions.importing.tests.tables import (
    DRIVE,
    POSITION,
    TIME,
    assert_same,
    read,
    status_of,
    table,
)
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.units import Unit, named
from tests.command_line import refused


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


def test_quoted_cells_may_have_commas_for_decimal_signs(imported, tmp_path):
    """As spreadsheets write them where commas part the columns, too."""
    numbers = zip(TIME, DRIVE, POSITION, strict=True)
    rows = [",".join(f'"{value:.6f}"'.replace(".", ",") for value in row) for row in numbers]
    (tmp_path / "log.csv").write_text("\n".join(['"time","drive","position"', *rows]))
    status_of(imported(str(tmp_path / "log.csv")))
    assert_same(read(tmp_path))


@pytest.mark.parametrize(
    "header",
    ["time [s],drive [V],position [mrad]", "time [s],drive [mV],position [rad]", "time [ms],drive [V],position [rad]",
     "time [s],drive [V],position [degC]", "time [min],drive [V],position [rad]"],
)  # fmt: skip
def test_units_of_a_second_file_that_contradict_the_mapping_are_refused(imported, tmp_path, header):
    first = table(tmp_path / "log.csv", "time [s],drive [V],position [rad]", TIME, DRIVE, POSITION)
    status_of(imported(first))
    refused(imported(table(tmp_path / "other.csv", header, TIME, DRIVE, POSITION)), "other.csv", "by its own name")


def test_a_unit_that_a_user_gives_stands_against_the_header(imported, tmp_path):
    header = "time [s],drive [V],position [rad]"
    status_of(imported(table(tmp_path / "log.csv", header, TIME, DRIVE, 1e3 * POSITION), "--unit", "position=mrad"))
    assert_same(read(tmp_path))
    status_of(imported(table(tmp_path / "next.csv", header, TIME, DRIVE, 1e3 * POSITION)))
    assert_same(read(tmp_path, "next"))


@pytest.mark.parametrize("delimiter", [",", " "])
def test_on_and_off_are_one_and_zero(imported, tmp_path, delimiter):
    words = np.where(DRIVE > 0.0, "on", "OFF")
    rows = [delimiter.join((f"{t:.2f}", w, f"{y:.6f}")) for t, w, y in zip(TIME, words, POSITION, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join([delimiter.join(("time", "drive", "position")), *rows]))
    status_of(imported(str(tmp_path / "log.csv")))
    np.testing.assert_array_equal(read(tmp_path).input[:-1, 0], (DRIVE > 0.0)[:-1])


@pytest.mark.parametrize("delimiter", [";", " "])
def test_text_of_two_bytes_a_letter_is_read(imported, tmp_path, delimiter):
    """As spreadsheets and LabVIEW save it."""
    header = delimiter.join(("time", "drive", "position"))
    plain = Path(table(tmp_path / "log.csv", header, TIME, DRIVE, POSITION, delimiter=delimiter, comma=True))
    plain.write_text(plain.read_text(), encoding="utf-16")
    status_of(imported(str(plain)))
    assert_same(read(tmp_path))


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


def test_a_number_that_stands_for_missing_values_is_known_in_a_second_file_too(imported, tmp_path):
    status_of(imported(table(tmp_path / "log.csv", "time,drive,position", TIME, DRIVE, POSITION)))
    output = POSITION.copy()
    output[[40, 90, 91, 200]] = -999.0
    said = status_of(imported(table(tmp_path / "next.csv", "time,drive,position", TIME, DRIVE, output)))
    assert "-999 in position is taken for a missing value" in said
    assert list(np.flatnonzero(~read(tmp_path, "next").measured)) == [40, 90, 91, 200]


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
        ("a.csv", b"t;u;y\n0;9;0.2\n1;1,098;0.25\n2;2,153;0.3\n3;1,250;0.4\n", "1,098 seems to have a sign between"),
        ("a.csv", b"t;u;y\n0;998;1\n1;999;1\n2;1.000;1\n3;1.001;1\n4;1.002;1\n", "1.000 seems to have a sign between"),
        ("a.csv", b't,u,y\n' + 9 * b'0.5,"1,000.25",0.2\n', "1,000.25 has a sign between its thousands"),
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
        ("n/(1/min)", "1/min", ["n"]),
        ("speed (measured)", "", ["speed"]),
        ("x[0]", "", ["x"]),
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
