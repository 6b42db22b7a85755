"""A rig that is made of a record identifies the equation behind it, at any time scale."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.importing.first_equation import delays_of, late
from hybrid_sysid_ros.extensions.importing.generated_rig import is_stepped, roles
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn
from tests.command_line import refused

GAIN, OFFSET, PERIODS, DAMPING = 2.0, 0.5, 12.5, 0.3
"""Of y / (rest of it); the time constant is so many sampling times."""


def response(period: float, samples: int = 1500):
    """Times, input and output of the equation under held random steps, with a little noise."""
    random, constant = np.random.default_rng(0), PERIODS * period
    law = np.array([[0.0, 1.0], [-(constant**-2), -2 * DAMPING / constant]]), np.array([[0.0], [constant**-2]])
    a, b, *_ = cont2discrete((*law, np.eye(2), np.zeros((2, 1))), period)
    inputs, state, outputs = np.repeat(random.uniform(-1, 1, samples // 40 + 1), 40)[:samples], np.zeros(2), []
    for u in inputs:
        outputs.append(state[0])
        state = a @ state + b[:, 0] * (GAIN * u + OFFSET)
    return period * np.arange(samples), inputs, np.array(outputs) + 0.002 * random.normal(size=samples)


def written(path, period: float, header: str) -> str:
    np.savetxt(path, np.column_stack(response(period)), delimiter=",", header=header, comments="", fmt="%.12g")
    return str(path)


@pytest.mark.parametrize("period", [3600.0, 1.0, 1.0 / 610.35, 1e-5])
def test_the_equation_is_found_at_any_time_scale(program, tmp_path, monkeypatch, period):
    monkeypatch.chdir(tmp_path)
    file, name = written(tmp_path / "log.csv", period, "time,heater [mV],temperature [K]"), f"oven_{round(1 / period)}"
    assert program("rig", "from", file, f"./{name}")[0] == 0
    rig = hs.load_rig(f"./{name}")
    assert [str(item) for item in (*rig.system.inputs, *rig.system.outputs)] == ["heater [V]", "temperature [K]"]
    first = dict(rig.system.named)
    assert first["gain"] == pytest.approx(1000 * GAIN, rel=0.05)  # K/V
    assert first["time_constant"] == pytest.approx(PERIODS * period, rel=0.1)
    assert first["damping"] == pytest.approx(DAMPING, abs=0.05)
    if period != 3600.0:
        return
    status, out, error = program("rig", "check", f"./{name}")
    assert (status, "no problems" in out) == (0, True), error
    assert program("import", file, "--rig", f"./{name}")[0] == 0
    model = hs.identify(hs.read_bag("bags/log", rig), rig, "gray", part=(0, 0.6))
    assert model.parameters["gain"] == pytest.approx(1000 * GAIN, rel=2e-3)
    assert model.parameters["offset"] == pytest.approx(OFFSET, abs=2e-3)
    assert model.parameters["time_constant"] == pytest.approx(PERIODS * period, rel=2e-3)
    assert model.parameters["damping"] == pytest.approx(DAMPING, abs=2e-3)


def test_its_numbers_and_units_are_written_as_people_do(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert program("rig", "from", written(tmp_path / "log.csv", 0.02, "time,heater,turn [°]"), "./oven")[0] == 0
    text = (tmp_path / "oven" / "rig.yaml").read_text(encoding="utf-8")
    assert "unit: °" in text
    assert "{step: 0.04, period: 0.04}" in text


def test_its_equation_is_simulated_stably_however_fast_it_decays(program, tmp_path, monkeypatch):
    """Towards a lag of first order, the damping of which has no end."""
    monkeypatch.chdir(tmp_path)
    file = written(tmp_path / "log.csv", 0.02, "time,heater,temperature")
    assert program("rig", "from", file, "./lag")[0] == 0
    rig = hs.load_rig("./lag")
    stiff = rig.system.with_values([*rig.system.values[:-1], rig.system.parameters[-1].high])
    states = simulate(stiff, np.array([1.0, 0.0]), np.zeros((2000, 1)), step=rig.step)
    assert np.abs(states).max() < 10.0


@pytest.mark.parametrize("dead", [0, 40])
def test_a_dead_time_of_many_samples_is_found(program, tmp_path, monkeypatch, dead):
    """In samples; the input begins with its first value before the record."""
    monkeypatch.chdir(tmp_path)
    times, inputs, outputs = response(0.01, 3000)
    driven = np.concatenate([inputs, np.full(dead, inputs[-1])])[dead:]  # what acts k + dead stands in row k
    table = np.column_stack([times, driven, outputs])[: 3000 - dead]
    np.savetxt("log.csv", table, delimiter=",", header="time,heater,temperature", comments="", fmt="%.12g")
    status, _, error = program("rig", "from", "log.csv", f"./late_oven_{dead}")
    assert status == 0, error
    rig = hs.load_rig(f"./late_oven_{dead}")
    assert rig.system.delay == pytest.approx(0.01 * dead, rel=0.15)
    assert rig.system.named["time_constant"] == pytest.approx(0.01 * PERIODS, rel=0.1)
    if dead:
        assert program("import", "log.csv", "--rig", f"./late_oven_{dead}")[0] == 0
        model = hs.identify(hs.read_bag("bags/log", rig), rig, "gray")
        assert model.parameters["heater_delay"] == pytest.approx(0.01 * dead, abs=2e-3)


FAST, SLOW = 8.0, 120.0
"""Time constants of two lags [samples]."""


@pytest.mark.parametrize(("name", "share"), [("heated_mass", 0.0), ("cell_of_charge", 0.3)])
def test_an_answer_at_once_is_found_and_identified_to_the_noise(program, tmp_path, monkeypatch, name, share):
    """Two lags side by side, whose fast one moves the rate, and a share of the input itself: a zero, or two."""
    monkeypatch.chdir(tmp_path)
    random, noise = np.random.default_rng(3), 0.002
    u = np.repeat(random.uniform(-1.0, 1.0, 40), 60)
    lags = [lfilter([0.0, 1.0 - np.exp(-1.0 / lag)], [1.0, -np.exp(-1.0 / lag)], u) for lag in (FAST, SLOW)]
    y = lags[0] + 2.0 * lags[1] + share * u + noise * random.normal(size=len(u))
    table = np.column_stack([np.arange(len(u)), u, y])
    np.savetxt("log.csv", table, delimiter=",", header="time,u,y", comments="", fmt="%.9g")
    assert program("rig", "from", "log.csv", f"./{name}")[0] == 0
    rig = hs.load_rig(f"./{name}")
    first = rig.system.named
    assert first["gain"] == pytest.approx(3.0 + share, rel=0.05)
    assert first["gain_of_change"] == pytest.approx(1.0 / FAST + 2.0 / SLOW, rel=0.05)
    assert first.get("gain_at_once", 0.0) == pytest.approx(share, abs=0.01)
    record = hs.record(time=np.arange(len(u)), inputs=u, outputs=y, rig=rig)
    for structure in ("gray", "hybrid"):
        model = hs.identify(record, rig, structure, part=(0, 0.6))
        run = model.free_run(record, part=(0.6, 1))
        assert np.std(run.measured - run.outputs) < 1.2 * noise
        model.save(tmp_path / structure)
        again = hs.load_model(tmp_path / structure, rig=f"./{name}")
        np.testing.assert_array_equal(again.system.values, model.system.values)


def test_an_output_of_the_name_of_another_ones_rate_keeps_it(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    times, inputs, roll = response(0.02)
    table = np.column_stack([times, inputs, np.gradient(roll, 0.02), roll])
    np.savetxt("log.csv", table, delimiter=",", header="time,torque,roll_rate,roll", comments="", fmt="%.9g")
    chosen = ("--input", "torque", "--output", "roll_rate", "--output", "roll")
    assert program("rig", "from", "log.csv", "./rolling", *chosen)[0] == 0
    names = [item.name for item in hs.load_rig("./rolling").system.states]
    assert len({*names}) == len(names)
    assert {"roll_rate", "roll"} < {*names}


def test_an_output_that_jumps_between_its_samples_makes_a_rig_that_loads(program, tmp_path, monkeypatch):
    """Of a sensor that jumps with its input and back: no lag is short enough, and none is below its own bound."""
    monkeypatch.chdir(tmp_path)
    times, inputs, _ = response(60.0)
    jumps = np.append(0.0, np.diff(inputs)) - 0.5 * np.append([0.0, 0.0], np.diff(inputs)[:-1])
    table = np.column_stack([np.round(times / 3600.0, 4), inputs, inputs + jumps])
    np.savetxt("log.csv", table, delimiter=",", header="Age (h),u,y", comments="", fmt="%.4f")
    assert program("rig", "from", "log.csv", "./fast_sensor")[0] == 0
    rig = hs.load_rig("./fast_sensor")
    assert rig.system.named["time_constant"] >= 0.5 * rig.step
    assert rig.step == 60.0  # hours of four digits are no clock that counts 59.9999999 s


def test_two_files_of_one_record_are_joined(program, tmp_path, monkeypatch):
    """As public benchmarks are kept: a column each, without times."""
    monkeypatch.chdir(tmp_path)
    _, inputs, outputs = response(0.02, 400)
    for name, column in (("X", inputs), ("Y", outputs)):
        np.savetxt(f"{name}.txt", column, header='"x"', comments="")
    joined = ("X.txt", "--also", "Y.txt", "--input", "X.x", "--output", "Y.x", "--period", "0.02")
    assert program("rig", "from", "X.txt", "./joined_drives", *joined[1:])[0] == 0
    assert program("import", "X.txt", "--also", "Y.txt", "--rig", "./joined_drives")[0] == 0
    record = hs.read_bag("bags/X", "./joined_drives")
    np.testing.assert_allclose(record.output[:, 0], outputs)
    np.testing.assert_allclose(record.input[:-1, 0], inputs[:-1])


@pytest.mark.parametrize(("offset", "limits"), [(0.0, (-1.5, 1.5)), (1.0, (0.0, 2.5)), (-3.0, (-4.5, -1.5))])
def test_limits_have_room_on_their_side_of_zero(program, tmp_path, monkeypatch, offset, limits):
    monkeypatch.chdir(tmp_path)
    times, inputs, outputs = response(0.02)
    table = np.column_stack([times, offset + inputs, outputs])
    np.savetxt("log.csv", table, delimiter=",", header="time,u,y", comments="")
    name = f"./pump_{offset:+.0f}".replace("-", "minus_").replace("+", "")
    status, _, error = program("rig", "from", "log.csv", name)
    assert status == 0, error
    actuator = hs.load_rig(name).actuators[0]
    assert (actuator.low, actuator.high) == pytest.approx(limits, abs=0.1)


def test_the_equation_of_two_devices_is_found_by_their_own_times(program, tmp_path, monkeypatch):
    """The second one counts hours, and began later."""
    monkeypatch.chdir(tmp_path)
    times, inputs, outputs = response(1.0)
    np.savetxt("plc.csv", np.column_stack([times, inputs]), delimiter=",", header="time,heater", comments="")
    daq = np.column_stack([times[100:] / 3600.0, outputs[100:]])
    np.savetxt("daq.csv", daq, delimiter=",", header="hours,temp", comments="", fmt="%.12g")
    assert program("rig", "from", "plc.csv", "./oven", "--also", "daq.csv")[0] == 0
    first = dict(hs.load_rig("./oven").system.named)
    assert first["time_constant"] == pytest.approx(PERIODS, rel=0.1)
    assert first["gain"] == pytest.approx(GAIN, rel=0.05)


def test_what_a_file_says_of_itself_stays_text(program, tmp_path, monkeypatch):
    """A unit and a file's name that would end the text in which they stand, and a name that Python has."""
    import h5py

    monkeypatch.chdir(tmp_path)
    strange_file = 'a""" + 1 + """.h5'
    strange = 'V" + "[" + str(1 / 0) + "'
    with h5py.File(strange_file, "w") as file:
        for name, values in zip(("time", "u", "y"), response(0.02, 400), strict=True):
            file[name] = values
        file["u"].attrs["unit"] = strange
    assert program("rig", "from", strange_file, "./none")[0] == 0
    assert hs.load_rig("./none").system.inputs[0].unit == strange


@pytest.mark.parametrize(
    ("header", "arguments", "words"),
    [
        ("time,a,b", (), ("which columns are inputs",)),
        ("a,u,y", (), ("no column is a time",)),
        ("time,u,y", ("--input", "z"), ("no column 'z'",)),
        ("time,u,y", ("--input", "u", "--output", "u"), ("u is an input and an output",)),
        ("time,u,y", ("--column", "u=y"), ("only time=COLUMN",)),
    ],
)
def test_doubtful_columns_are_asked(program, tmp_path, header, arguments, words):
    file = written(tmp_path / "log.csv", 0.01, header)
    refused(program("rig", "from", file, str(tmp_path / "made"), *arguments), *words)
    assert not (tmp_path / "made").exists()


def test_columns_that_are_left_out_are_named(program, tmp_path):
    times, inputs, outputs = response(0.01)
    header = "time,current_mA,flow,pressure_bar"
    file = tmp_path / "valve.csv"
    np.savetxt(file, np.column_stack([times, inputs, outputs, outputs]), delimiter=",", header=header, comments="")
    status, out, error = program("rig", "from", str(file), str(tmp_path / "guessed"))
    assert (status, "left out: flow" in out) == (0, True), out + error
    chosen = ("--input", "current_mA", "--output", "pressure_bar")
    status, out, error = program("rig", "from", str(file), str(tmp_path / "chosen"), *chosen)
    assert (status, "left out" in out) == (0, False), out + error


def test_an_angle_that_wraps_is_unwrapped_by_import_and_by_the_rig(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time, drive, angle = response(0.02)
    turned = 400.0 * angle
    rows = np.column_stack([time, drive, turned % 360.0])
    np.savetxt("log.csv", rows, delimiter=",", header="time,drive,angle [deg]", comments="", fmt="%.9g")
    status, out, error = program("rig", "from", "log.csv", "./turner")
    assert (status, "angle comes modulo a turn" in out) == (0, True), error
    status, out, error = program("import", "log.csv", "--rig", "./turner")
    assert (status, "(unwrap)" in out + error) == (0, True), error
    found = hs.read_bag("bags/log", hs.load_rig("./turner")).output[:, 0]
    np.testing.assert_allclose(np.degrees(found - found[0]), turned - turned[0], atol=1e-4)


def test_a_record_with_an_impossible_value_makes_no_rig(program, tmp_path):
    """The square of 1e308, which a fit takes, is no number."""
    path = tmp_path / "a.csv"
    time, u, y = response(0.01)
    y[9] = -1e308
    np.savetxt(path, np.column_stack((time, u, y)), delimiter=",", header="t,u,y", comments="", fmt="%.12g")
    refused(
        program("rig", "from", str(path), str(tmp_path / "made")), "y has values that no rig reaches, such as 1e+308"
    )


def test_a_force_and_a_position_are_no_x_and_its_y(program, tmp_path):
    status, out, error = program("rig", "from", written(tmp_path / "log.csv", 0.01, "t,F,x"), str(tmp_path / "cart"))
    assert (status, "inputs: F; outputs: x" in out) == (0, True), out + error


def test_missing_values_that_a_number_marks_are_left_out(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time, u, y = response(0.02)
    y[[300, 301, 302, 700]] = -999.0
    np.savetxt("log.csv", np.column_stack([time, u, y]), delimiter=",", header="time,u,y", comments="")
    status, out, error = program("rig", "from", "log.csv", "./marked")
    assert (status, "y: -999 stands for missing values" in out) == (0, True), out + error
    assert program("import", "log.csv", "--rig", "./marked")[0] == 0
    record = hs.read_bag("bags/log", "./marked")
    assert record.output.min() > -10.0
    assert record.measured is not None
    assert np.flatnonzero(~record.measured).tolist() == [300, 301, 302, 700]
    (tmp_path / "marked" / "import.yaml").unlink()
    assert program("import", "log.csv", "--rig", "./marked", "--overwrite")[0] == 0
    assert "missing: -999" in (tmp_path / "marked" / "import.yaml").read_text()


def test_an_angle_that_wraps_is_unwrapped_without_its_unit(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time, drive, angle = response(0.02)
    turned = 8.0 * angle
    rows = np.column_stack([time, drive, turned % (2.0 * np.pi)])
    np.savetxt("log.csv", rows, delimiter=",", header="time,drive,angle", comments="", fmt="%.9g")
    status, out, error = program("rig", "from", "log.csv", "./turner")
    assert (status, "angle comes modulo a turn [rad]" in out) == (0, True), out + error
    assert program("import", "log.csv", "--rig", "./turner")[0] == 0
    found = hs.read_bag("bags/log", "./turner").output[:, 0]
    np.testing.assert_allclose(found - found[0], turned - turned[0], atol=1e-6)


COLUMNS = [LogColumn(name=name, samples=9) for name in ("Heizung", "T1_degC", "T2_degC", "setpoint", "status")]
PUMP = [LogColumn(name=name, samples=9) for name in ("speed_rpm", "flow_L_min", "pressure_bar")]
HOUSE = [LogColumn(name=name, samples=9) for name in ("heater_W", "sun_W_m2", "outside_degC", "level", "inside_degC")]


@pytest.mark.parametrize(
    ("columns", "inputs", "outputs", "found"),
    [
        (COLUMNS, ["Heizung"], [], (["Heizung"], ["T1_degC", "T2_degC"])),
        (COLUMNS, ["Heizung"], ["T2_degC"], (["Heizung"], ["T2_degC"])),
        (PUMP, [], [], (["speed_rpm"], ["pressure_bar"])),
        (PUMP, ["speed_rpm"], [], (["speed_rpm"], ["pressure_bar", "flow_L_min"])),
        (HOUSE, [], ["inside_degC"], (["heater_W", "sun_W_m2", "outside_degC"], ["inside_degC"])),
    ],
)
def test_what_the_columns_are_that_nobody_named(columns, inputs, outputs, found):
    assert roles(columns, inputs, outputs, lambda name: name == "speed_rpm") == found


def test_what_is_set_in_steps_is_told_from_what_is_counted():
    random = np.random.default_rng(3)
    assert is_stepped(np.repeat(random.uniform(size=20), 50))
    assert not is_stepped(np.round(20 * np.sin(np.linspace(0, 6, 4000))))  # an encoder's counts
    assert not is_stepped(random.normal(size=1000))
    assert not is_stepped(np.ones(100))


def test_a_sine_says_nothing_of_a_dead_time():
    time, constant = 1e-3 * np.arange(4000), 0.02
    sine, steps = np.sin(80.0 * np.pi * time), np.repeat(np.random.default_rng(0).normal(size=100), 40)
    for values, delay in ((sine, 0), (steps, 12)):
        later = lfilter([1e-3 / constant], [1.0, 1e-3 / constant - 1.0], late(values, 12))
        found = delays_of([later], [values], 1, 1e-3, 10.0)[0]
        assert found == pytest.approx(delay, abs=2)


def test_a_column_that_nobody_named_and_that_never_changes_is_left_out(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    times, inputs, outputs = response(0.02)
    np.savetxt("log.csv", np.column_stack([times, inputs, outputs, 0.0 * times + 21.0]), delimiter=",", comments="",
               header="time,heater,temperature,room_temperature", fmt="%.12g")  # fmt: skip
    status, said, error = program("rig", "from", "log.csv", "./still_room")
    assert status == 0, error
    assert "left out: room_temperature, which never changes" in said
    assert len(hs.load_rig("./still_room").system.outputs) == 1
    options = ("--input", "heater", "--output", "temperature", "--output", "room_temperature")
    refused(program("rig", "from", "log.csv", "./named_room", *options), "always the same")
