"""A law that was guessed from a record accuses no sensor of its own errors."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.hysteresis import played
from hybrid_sysid_ros.extensions.record_check.tests.records import STEPS, driven_lag


def test_a_valve_that_sticks_is_no_delay_of_the_rig_of_its_record(call, tmp_path, monkeypatch):
    """The rig's equation takes a play for a longer lag, so that every output seemed to answer early."""
    monkeypatch.chdir(tmp_path)
    time, flow = np.arange(float(len(STEPS))), driven_lag(played(STEPS, 0.4))
    np.savetxt("v.csv", np.column_stack([time, STEPS, flow]), delimiter=",", header="time,valve,y", comments="")
    program = partial(call, app.main, "hybrid-sysid")
    assert program("rig", "from", "v.csv", "./stiction")[0] == program("import", "v.csv", "--rig", "./stiction")[0] == 0
    found = findings_of(hs.read_bag("bags/v", "./stiction"), hs.load_rig("./stiction"))
    assert [item.kind for item in found] == ["hysteresis"]
    assert "as if valve turned round within a play of 0.4" in found[0].words


def test_a_pendulum_that_goes_round_contradicts_the_guessed_law_and_not_its_sensor(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    random, state, angles = np.random.default_rng(0), np.zeros(2), []
    torque = np.repeat(random.uniform(-8.0, 8.0, 30), 100)
    for u in torque:
        angles.append(state[0])
        for _ in range(5):
            state = state + 0.002 * np.array([state[1], u - 9.81 * np.sin(state[0]) - 0.5 * state[1]])
    rows = np.column_stack([0.01 * np.arange(3000), torque, angles])
    np.savetxt("p.csv", rows, delimiter=",", header="time,torque [Nm],angle [rad]", comments="")
    program = partial(call, app.main, "hybrid-sysid")
    status, out, _ = program("rig", "from", "p.csv", "./pendulum_round")
    assert (status, "angle goes beyond half a turn" in out) == (0, True)
    assert program("import", "p.csv", "--rig", "./pendulum_round")[0] == 0
    found = findings_of(hs.read_bag("bags/p", "./pendulum_round"), hs.load_rig("./pendulum_round"))
    assert found[0].kind == "another law"
    assert "a guess" in found[0].cure
    assert not found[0].blocks


def test_a_guessed_law_that_is_slower_than_the_rig_accuses_no_sensor_of_haste(call, tmp_path, monkeypatch):
    """A lag of first order, which an equation of second order would follow a step of the fit later."""
    monkeypatch.chdir(tmp_path)
    u = np.repeat(np.random.default_rng(0).choice([0.0, 5.0], 400), 50)
    rows = np.column_stack([1e-5 * np.arange(len(u)), u, lfilter([0.0, 0.01], [1.0, -0.99], u)])
    rows[:, 2] += 0.005 * np.random.default_rng(1).normal(size=len(u))
    np.savetxt("rc.csv", rows, delimiter=",", header="time,v_in,v_out", comments="")
    program = partial(call, app.main, "hybrid-sysid")
    assert (
        program("rig", "from", "rc.csv", "./low_pass")[0] == program("import", "rc.csv", "--rig", "./low_pass")[0] == 0
    )
    rig = hs.load_rig("./low_pass")
    assert findings_of(hs.read_bag("bags/rc", rig), rig) == []
    assert [item.name for item in rig.system.states] == ["v_out"]
    assert rig.system.named["time_constant"] == pytest.approx(1e-3, rel=0.06)
    assert round(5e-4 / rig.step, 6).is_integer()  # edges of the input lie between steps


def test_sensors_of_a_chain_are_swapped_and_not_late(call, tmp_path, monkeypatch):
    """The guessed law is of lower order than the last of five lags, which is no fault of a sensor."""
    monkeypatch.chdir(tmp_path)
    chain, random = [STEPS], np.random.default_rng(6)
    for _ in range(5):
        chain.append(lfilter([0.0, 0.06], [1.0, -0.94], chain[-1]))
    temperatures = np.column_stack(chain[1:]) + 0.002 * random.normal(size=(len(STEPS), 5))
    header = "time,heater_W," + ",".join(f"T{k}_degC" for k in range(1, 6))
    rows = np.column_stack([np.arange(len(STEPS)), STEPS, temperatures])
    np.savetxt("chain.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
    outputs = [part for k in range(1, 6) for part in ("--output", f"T{k}_degC")]
    program = partial(call, app.main, "hybrid-sysid")
    assert program("rig", "from", "chain.csv", "./chain_of_lags", "--input", "heater_W", *outputs)[0] == 0
    assert program("import", "chain.csv", "--rig", "./chain_of_lags")[0] == 0
    rig = hs.load_rig("./chain_of_lags")
    r = hs.read_bag("bags/chain", rig)
    assert findings_of(r, rig) == []
    assert not any(item.name.endswith("_lagging") for item in rig.system.states)  # nothing answers at once
    swapped = findings_of(replace(r, output=r.output[:, [0, 3, 2, 1, 4]]), rig)
    assert [item.kind for item in swapped] == ["swapped channels"]


def test_a_turned_angle_is_seen_where_a_loop_holds_what_integrates_and_its_noise_is_no_play(
    call, tmp_path, monkeypatch
):
    """A roll axis under a feedback, whose noisy commands are all that the record has of it."""
    monkeypatch.chdir(tmp_path)
    random, state, rows = np.random.default_rng(7), np.zeros(3), []
    for k, wanted in enumerate(np.repeat(random.uniform(-0.4, 0.4, 16), 300)):
        angle, rate = state[:2] + [0.001, 0.01] * random.normal(size=2)
        torque = np.clip(1.5 * (wanted - angle) - 0.3 * rate, -0.8, 0.8)
        rows.append([0.005 * k, torque, angle, rate])
        for _ in range(5):
            state = state + 0.001 * np.array(
                [state[1], (state[2] - 0.004 * state[1]) / 0.012, (torque - state[2]) / 0.03]
            )
    np.savetxt("axis.csv", rows, delimiter=",", header="time,torque_Nm,roll_rad,rate_rad_s", comments="")
    program = partial(call, app.main, "hybrid-sysid")
    assert program("rig", "from", "axis.csv", "./held_axis")[0] == 0
    assert program("import", "axis.csv", "--rig", "./held_axis")[0] == 0
    rig = hs.load_rig("./held_axis")
    r = hs.read_bag("bags/axis", rig)
    assert findings_of(r, rig) == []
    turned = findings_of(replace(r, output=r.output * [-1.0, 1.0]), rig)
    assert [item.kind for item in turned] == ["sign"]
    assert turned[0].words.startswith("roll")


def test_another_unit_is_seen_in_noise_too(call, tmp_path, monkeypatch):
    """Where noise hides how a guessed law answers changes, and a factor undoes the error of the whole."""
    monkeypatch.chdir(tmp_path)
    lag = lfilter([0.05], [1.0, -0.95], STEPS)
    speed = lag + 0.1 * lag.std() * np.random.default_rng(3).normal(size=len(lag))
    rows = np.column_stack([np.arange(len(lag)), STEPS, speed])
    np.savetxt("boat.csv", rows, delimiter=",", header="time,throttle,speed_m_s", comments="", fmt="%.9g")
    program = partial(call, app.main, "hybrid-sysid")
    assert program("rig", "from", "boat.csv", "./noisy_boat")[0] == 0
    assert program("import", "boat.csv", "--rig", "./noisy_boat")[0] == 0
    rig = hs.load_rig("./noisy_boat")
    r = hs.read_bag("bags/boat", rig)
    assert findings_of(r, rig) == []
    found = findings_of(replace(r, output=3.6 * r.output), rig)
    assert found[0].kind == "scale"
    assert "moves 3." in found[0].words
