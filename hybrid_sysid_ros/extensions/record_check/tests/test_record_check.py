"""Faults of a record are named first, and a good record is accused of none."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags import joint_states, write_bag
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.importing.tests.test_rig_from import written
from hybrid_sysid_ros.extensions.record_check.changes import changes_of
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.hysteresis import hysteresis_of, played
from hybrid_sysid_ros.extensions.record_check.relation import answers, wanders
from hybrid_sysid_ros.extensions.record_check.response import input_acts_as_held
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal, sample_findings
from hybrid_sysid_ros.extensions.shared.sentinel import sentinel_of
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of, unwrapped, wraps_of
from tests.command_line import refused

ROOT = Path(__file__).parents[4]

RIG = "wheel_motor"


@cache
def record():
    return bags.read(ROOT / "bags" / "wheel_motor_multisine", hs.load_rig(RIG).signals)


def first(output=None, inputs=None, **changed) -> str:
    """The kind of finding that is named first."""
    r = record()
    spoilt = replace(
        r, output=r.output if output is None else output, input=r.input if inputs is None else inputs, **changed
    )
    found = findings_of(spoilt, hs.load_rig(RIG))
    return found[0].kind if found else ""


def test_a_good_record_is_accused_of_nothing():
    assert first() == ""


def test_a_rig_that_a_loop_holds_upright_is_not_compared_with_its_fall():
    held = bags.read(ROOT / "bags" / "balancing_robot_multisine", hs.load_rig("balancing_robot").signals)
    assert "no relation" not in [item.kind for item in findings_of(held, hs.load_rig("balancing_robot"))]


def test_each_fault_is_named_first():
    r, random = record(), np.random.default_rng(0)
    y, u, t = r.output, r.input, r.time
    frozen, spiked = y.copy(), y.copy()
    frozen[300:600] = frozen[300]
    spiked[random.choice(len(y), 5)] = 3.0 * y.max()
    late = np.interp(t - 0.08, t, y[:, 0])[:, None]
    slow = np.interp(1.006 * t, t, y[:, 0])[:, None]
    measured = random.uniform(size=len(y)) > 0.05
    assert first(-y) == first(inputs=-u) == "sign"
    assert findings_of(replace(r, output=-y), hs.load_rig(RIG))[0].blocks
    assert first(2.0 * y) == first(0.5 * y) == "scale"
    assert first(late) == "delay"
    assert first(slow) == "clock drift"
    assert first(frozen) == "frozen"
    assert first(spiked) == "spikes"
    assert first(np.clip(y, 0.5 * y.min(), 0.5 * y.max())) == "clipped"
    assert first(np.repeat(y[::10], 10, axis=0)[: len(y)]) == "held"
    assert first(0.0 * y) == "constant output"
    assert first(inputs=0.0 * u) == "no excitation"
    assert first(measured=measured) == "missing samples"
    assert findings_of(r.between(100, 160), hs.load_rig(RIG))[0].kind == "short"
    assert first(y.std() * random.normal(size=y.shape)) in ("no relation", "noise")


@pytest.mark.parametrize(("part", "words"), [(slice(1000, 3000), "from about"), (slice(1500, None), "on;")])
def test_a_fault_in_a_part_of_the_record_is_named_with_its_place(part, words):
    """A range that was changed, samples that were lost, a zero that was set anew."""
    rig = hs.load_rig("flexible_joint")
    r = bags.read(ROOT / "bags" / "flexible_joint_multisine", rig.signals)
    assert findings_of(r, rig) == []
    turned, larger, late, away = (r.output.copy() for _ in range(4))
    turned[part] *= -1.0
    larger[part] *= 2.0
    late[part] = np.roll(r.output, 20, axis=0)[part]
    away[part.start :] += 0.3 * np.ptp(r.output, axis=0)
    found = {kind: findings_of(replace(r, output=y), rig)[0] for kind, y in (
        ("change of sign", turned), ("change of scale", larger), ("change of delay", late), ("jump", away),
    )}  # fmt: skip
    assert {kind: item.kind for kind, item in found.items()} == {kind: kind for kind in found}
    assert all(words in str(found[f"change of {what}"]) for what in ("sign", "scale"))
    assert f"sample {part.start} " in found["jump"].words


@pytest.mark.parametrize("period", [3600.0, 1e-4])
def test_faults_are_named_at_any_time_scale(call, tmp_path, monkeypatch, period):
    monkeypatch.chdir(tmp_path)
    file = written(tmp_path / "log.csv", period, "time,u,y")
    program = partial(call, app.main, "hybrid-sysid")
    name = f"./scale_{round(1 / period)}"
    assert program("rig", "from", file, name)[0] == program("import", file, "--rig", name)[0] == 0
    rig = hs.load_rig(name)
    r = hs.read_bag("bags/log", rig)
    y, k = r.output, np.arange(r.samples)
    stuck = y.copy()
    stuck[300:500] = stuck[300]
    faults = {
        "sign": -y, "delay": np.interp(k - 8, k, y[:, 0])[:, None], "frozen": stuck, "scale": 2.0 * y,
        "clock drift": np.interp(1.015 * k, k, y[:, 0])[:, None], "held": np.repeat(y[::10], 10, axis=0),
    }  # fmt: skip
    assert findings_of(r, rig) == []
    assert {kind: findings_of(replace(r, output=output), rig)[0].kind for kind, output in faults.items()} == {
        kind: kind for kind in faults
    }


def driven_lag(values):
    """T y' = u - y with T of 20 samples, and a little noise."""
    lag = lfilter([0.05], [1.0, -0.95], values)
    return lag + 0.003 * np.ptp(lag) * np.random.default_rng(1).normal(size=len(lag))


STEPS = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 60), 50)


@pytest.mark.parametrize("where", ["input", "sensor"])
def test_a_play_is_found_with_its_place_and_width(where):
    width = 0.2 * np.ptp(STEPS if where == "input" else driven_lag(STEPS))
    output = driven_lag(played(STEPS, width)) if where == "input" else played(driven_lag(STEPS), width)
    found = hysteresis_of([STEPS], output)
    assert found is not None
    assert found.input == (0 if where == "input" else None)
    assert found.width == pytest.approx(width, rel=0.3)


@pytest.mark.parametrize(
    "output",
    [
        driven_lag(STEPS), np.tanh(2.0 * driven_lag(STEPS)), np.cumsum(driven_lag(STEPS)), np.abs(driven_lag(STEPS)),
        np.roll(driven_lag(STEPS), 30), driven_lag(np.clip(STEPS, -0.3, 0.3)),
        np.random.default_rng(2).normal(size=len(STEPS)),
    ],
)  # fmt: skip
def test_what_only_bends_lags_or_adds_up_has_no_play(output):
    assert hysteresis_of([STEPS], output) is None


@pytest.mark.parametrize("values", [STEPS, np.sign(STEPS)], ids=["steps", "two levels"])
@pytest.mark.parametrize("begins", [0.0, 2.0])
def test_where_a_record_begins_is_no_play(values, begins):
    """Of two levels a play makes two levels, but for its beginning: it explained how a lag comes to rest."""
    away = begins * 0.995 ** np.arange(len(values))
    assert hysteresis_of([values], driven_lag(values) + away) is None


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


def test_where_nothing_moves_nothing_is_said_of_signs():
    """In the play of friction any answer is chance."""
    rig = hs.load_rig("flexible_joint")
    r = bags.read(ROOT / "bags" / "flexible_joint_multisine", rig.signals)
    found = findings_of(replace(r, input=0.003 * r.input, output=-0.003 * r.output), rig)
    assert found[0].kind == "no excitation"
    assert "sign" not in [item.kind for item in found]


def test_a_held_input_that_one_output_answers_in_time_is_no_fault():
    """The rig's physics may make an output slower than it is, so that it alone seems to answer early."""
    rig = hs.load_rig("flexible_joint")
    r = bags.read(ROOT / "bags" / "flexible_joint_random_steps", rig.signals)
    early = np.column_stack([np.roll(r.output[:, 0], -8), r.output[:, 1]])
    every = round(1.0 / r.sampling_time / 10)
    assert input_acts_as_held(r, rig, every) is input_acts_as_held(replace(r, output=early), rig, every) is True
    assert input_acts_as_held(replace(r, output=np.roll(r.output, -8, axis=0)), rig, 20) is False


def test_an_input_that_rests_while_another_one_moves_blocks_no_fit():
    rig = hs.load_rig("winged_cone")
    r = bags.read(ROOT / "bags" / "winged_cone_climbs", rig.signals).between(0, 1000)
    inputs = r.input.copy()
    inputs[:, 0] = inputs[0, 0]
    found = findings_of(replace(r, input=inputs), rig)
    assert [(item.kind, item.blocks) for item in found] == [("no excitation", False)]
    assert "throttle" in found[0].words
    assert findings_of(replace(r, input=0.0 * inputs), rig)[0].blocks


@pytest.fixture
def turned(tmp_path) -> str:
    """A bag whose sensor counts the other way round."""
    r = record()
    stamps = np.int64(1e9) + np.round(1e9 * r.time).astype(np.int64)
    effort = np.roll(r.input, 1, axis=0)
    wheel = joint_states(f"/{RIG}/joint_states", stamps, ["wheel"], velocity=-r.output, effort=effort)
    return str(write_bag(tmp_path / "turned", [wheel]))


def test_the_command_says_what_to_do_and_its_status_tells_scripts(call, turned, tmp_path):
    check = partial(call, app.main, "hybrid-sysid", "check-record", "--rig", RIG)
    status, out, _ = check(str(ROOT / "bags" / "wheel_motor_multisine"))
    assert (status, "no fault" in out) == (0, True)
    status, out, _ = check(turned, "--report", str(tmp_path / "page.html"))
    assert "goes the other way" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert status == 1
    assert "worth nothing before this is cured: sign" in out
    assert json.loads(check(turned, "--json")[1])[turned][0]["kind"] == "sign"
    refused(check(turned, turned), "two bags are called turned")


def test_identify_refuses_what_is_worth_nothing_unless_it_is_wanted_anyway(call, turned, tmp_path):
    options = ("--rig", RIG, "--out", str(tmp_path / "m"), "--structure", "gray", "--part", "0:0.3")
    fit = partial(call, app.main, "hybrid-sysid", "identify", turned, *options)
    refused(fit(), "sign", "--anyway")
    assert fit("--anyway")[0] == 0


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2.0 * np.pi), ("deg", 360.0), ("turn", 1.0)])
@pytest.mark.parametrize("low", [0.0, 0.5])
def test_an_angle_that_wraps_is_made_whole(unit, turn, low):
    """A turn may begin at 0 or in the middle; a filter may leave a sample between both ends."""
    assert turn_of(unit) == pytest.approx(turn)
    time = np.linspace(0.0, 20.0, 2000)
    angle = turn * (1.7 * np.sin(0.7 * time) + 0.3 * np.sin(3.1 * time))
    wrapped = (angle + low * turn) % turn - low * turn
    assert len(wraps_of(wrapped, turn)) == int((np.abs(np.diff(wrapped)) > 0.8 * turn).sum())
    whole = unwrapped(wrapped, turn)
    np.testing.assert_allclose(whole - whole[0], angle - angle[0], atol=1e-9 * turn)
    first = int(wraps_of(wrapped, turn)[0])
    torn = wrapped.copy()
    torn[first + 1] = 0.5 * (wrapped[first] + wrapped[first + 2])
    np.testing.assert_allclose(unwrapped(torn, turn) - whole[0], angle - angle[0], atol=0.02 * turn)


def test_what_is_a_turn_wide_and_jumps_with_its_motion_does_not_wrap():
    steps = np.repeat([0.0, 2 * np.pi, 0.0, 2 * np.pi], 100)
    assert len(wraps_of(steps, 2.0 * np.pi)) == 0
    assert len(wraps_of(np.pi * np.sin(np.linspace(0, 20, 2000)), 2.0 * np.pi)) == 0
    random = np.random.default_rng(0)
    assert len(wraps_of(random.uniform(0.0, 360.0, 3000), 360.0)) == 0
    held = np.repeat(random.uniform(0.0, 360.0, 150), 20)
    assert len(wraps_of(held, 360.0)) == 0
    assert len(wraps_of(lfilter([0.9], [1.0, -0.1], np.where(held > 180.0, 360.0, 0.0)), 360.0)) == 0


@pytest.mark.parametrize("whole", [np.minimum(np.arange(2000) / 160.0, np.pi), 2.0 * np.arange(2000) / 100.0])
def test_an_angle_that_is_noisy_or_stays_where_it_wraps_does_wrap(whole):
    noisy = whole + 0.05 * np.random.default_rng(0).normal(size=len(whole))
    wrapped = (noisy + np.pi) % (2.0 * np.pi) - np.pi
    assert len(wraps_of(wrapped, 2.0 * np.pi)) == int(np.count_nonzero(np.diff((noisy + np.pi) // (2.0 * np.pi))))
    np.testing.assert_allclose(unwrapped(wrapped, 2.0 * np.pi), noisy, atol=1e-9)
    assert turn_of("V") is None
    assert turn_of("deg/s") is None


def test_spikes_of_what_wanders_are_found_and_answers_to_steps_are_none():
    random = np.random.default_rng(0)
    signal = partial(CheckedSignal, name="y", unit="rad", period=0.01, is_input=False, noise=2e-3)
    far = 40.0 * np.sin(np.linspace(0.0, 6.0, 4000)) + np.sin(np.linspace(0.0, 300.0, 4000))
    wandering = far + 2e-3 * random.normal(size=4000)
    assert list(sample_findings(signal(values=wandering))) == []
    spiked = wandering.copy()
    spiked[random.choice(4000, 25, replace=False)] += 4.0
    (found,) = sample_findings(signal(values=spiked))
    assert (found.kind, "25 spikes" in found.words) == ("spikes", True)
    u = np.repeat(random.choice([-1.0, 1.0], 20), 200)
    peaks = lfilter([1.0, -1.0], [1.0, -0.2], u) + 2e-3 * random.normal(size=4000)  # a pressure behind a valve
    assert [item.kind for item in sample_findings(signal(values=peaks), [u])] == []
    (found,) = sample_findings(signal(values=peaks), [np.roll(u, 100)])
    assert found.kind == "spikes"


def test_an_angle_that_wraps_and_an_impossible_value_have_their_own_names():
    time = np.linspace(0.0, 20.0, 2000)
    signal = partial(CheckedSignal, name="angle", unit="rad", period=0.01, is_input=False)
    wrapped = (8.0 * np.sin(time)) % (2.0 * np.pi)
    (found,) = sample_findings(signal(values=wrapped))
    assert (found.kind, found.blocks, "unwrap: true" in found.cure) == ("the angle wraps", True, True)
    (found,) = sample_findings(signal(values=np.where(time == time[9], 4.75e38, wrapped)))
    assert (found.kind, found.blocks) == ("impossible values", True)


@pytest.mark.parametrize("seed", range(5))
def test_a_walk_is_related_to_no_input_and_an_answer_in_noise_is(seed):
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-1.0, 1.0, 100), 20)
    lagged = lfilter([0.02], [1.0, -0.98], u)
    walk = np.cumsum(random.normal(size=2000))
    assert wanders(u[:, None], walk)
    assert not wanders(u[:, None], lagged + 0.2 * random.normal(size=2000))
    assert not wanders(u[:, None], np.abs(lagged) + 0.01 * random.normal(size=2000))


@pytest.mark.parametrize("dead", [0, 300, 1200])
def test_a_product_of_inputs_and_a_long_dead_time_are_answers_and_chance_is_none(dead):
    random = np.random.default_rng(dead)
    u = np.repeat(random.uniform(-1.0, 1.0, (100, 2)), 60, axis=0)
    driven = lfilter([0.03], [1.0, -0.97], u[:, 0] * u[:, 1])
    late = np.append(np.zeros(dead), driven)[: len(u)] + 0.005 * random.normal(size=len(u))
    assert answers(u, late)
    other = lfilter([0.03], [1.0, -0.97], np.repeat(random.uniform(-1.0, 1.0, 100), 60))
    assert not answers(u, other + 0.005 * random.normal(size=len(u)))
    assert not answers(np.roll(late, 0)[:, None], u[:, 0])  # what comes later


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


@pytest.mark.parametrize("value", [-999.0, 9999.0, 3276.7, 12345.0])
def test_a_number_that_stands_for_missing_values_is_named(value):
    random = np.random.default_rng(0)
    whole = 300.0 + np.cumsum(random.normal(size=2000))
    marked = np.where(random.uniform(size=2000) < 0.01, value, whole)
    (found,) = sample_findings(CheckedSignal(name="t", unit="K", values=marked, period=0.1, is_input=False))
    assert (found.kind, found.blocks) == ("sentinel value", False)
    assert sentinel_of(whole) is None
    assert sentinel_of(np.where(whole > np.median(whole), 999.0, 0.0)) is None  # two levels
    assert sentinel_of(np.minimum(whole, np.quantile(whole, 0.9))) is None  # clipped


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


def test_an_angle_without_a_unit_wraps_too():
    wrapped = np.degrees(8.0 * np.sin(np.linspace(0.0, 20.0, 2000))) % 360.0
    (found,) = sample_findings(CheckedSignal(name="a", unit="1", values=wrapped, period=0.01, is_input=False))
    assert found.kind == "the angle wraps"
    assert "--unit a=deg" in found.cure


def test_values_beyond_all_numbers_make_no_warnings():
    values = np.where(np.arange(2000) % 7 == 3, 1e300, np.sin(np.arange(2000.0)))
    with np.errstate(all="raise"):
        (found,) = sample_findings(CheckedSignal(name="a", unit="1", values=values, period=0.01, is_input=False))
        findings_of(replace(record(), output=1e300 * record().output), hs.load_rig(RIG))
    assert found.kind == "impossible values"


def test_what_changes_by_little_and_lasts_is_named():
    """A zero, a scale and a drift that no jump and no size of the whole shows."""
    rig = hs.load_rig("flexible_joint")
    r = bags.read(ROOT / "bags" / "flexible_joint_multisine", rig.signals)
    y, half = r.output, np.arange(r.samples) >= r.samples // 2
    size, whole = np.ptp(y, axis=0), np.arange(r.samples) / r.samples
    faults = {
        "jump": y + 0.1 * size * half[:, None],
        "change of scale": np.where(half[:, None], 1.3, 1.0) * y,
        "sensor drift": y + 0.3 * size * whole[:, None],
    }
    found = {kind: findings_of(replace(r, output=output), rig) for kind, output in faults.items()}
    assert {kind: items[0].kind if items else "" for kind, items in found.items()} == {kind: kind for kind in faults}


@pytest.mark.parametrize(("part", "words"), [(slice(1500, None), "from about"), (slice(0, 1500), "until about")])
def test_noise_that_begins_or_ends_within_a_record_is_named(part, words):
    """In either half: the squares of a stretch and of its rest are the same."""
    expected, noisy = driven_lag(STEPS), np.zeros(len(STEPS))
    noisy[part] = np.random.default_rng(5).normal(size=len(STEPS))[part]
    signal = CheckedSignal(name="y", unit="m", values=expected + 0.05 * noisy, period=0.1, is_input=False)
    (found,) = changes_of(signal, expected, [STEPS], 5, guessed=False)
    assert found.kind == "change of noise"
    assert words in found.words


def test_a_zero_that_jumps_is_seen_in_a_signal_that_wanders_far():
    """A heading, made whole over many turns: 12 degrees, where it else changes by less than one in a sample."""
    heading = 0.8 * np.cumsum(lfilter([0.05], [1.0, -0.95], STEPS))
    jumped = heading + 12.0 * (np.arange(len(heading)) >= 1500) + 0.1 * np.random.default_rng(4).normal(size=3000)
    signal = CheckedSignal(name="heading", unit="deg", values=jumped, period=1.0, is_input=False, noise=0.1)
    found = list(changes_of(signal, heading, [STEPS], 5, guessed=True))
    assert [item.kind for item in found] == ["jump"]


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


def test_an_input_of_drawn_levels_is_no_recorder_that_holds():
    """Where nobody can tell, as beside noise; samples of a slow sine are held by somebody."""
    rig = hs.load_rig(RIG)
    r, k = record(), np.arange(record().samples)
    noise = np.random.default_rng(9).normal(size=r.output.shape)
    drawn = np.random.default_rng(8).uniform(-1.0, 1.0, len(k) // 20 + 1)[k // 20]
    slow = np.sin(0.02 * (k // 20 * 20))
    for values, kinds in ((drawn, 0), (slow, 1)):
        found = findings_of(replace(r, input=100.0 * values[:, None], output=noise), rig)
        assert sum(item.kind == "held" for item in found) == kinds
