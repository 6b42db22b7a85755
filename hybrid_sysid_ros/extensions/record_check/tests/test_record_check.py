"""Faults of a record are named first, and a good record is accused of none."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags import joint_states, write_bag
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.importing.tests.test_rig_from import written
from hybrid_sysid_ros.extensions.record_check.applied_input import acts_as_held
from hybrid_sysid_ros.extensions.record_check.changes import changes_of
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.expectation import expected_outputs
from hybrid_sysid_ros.extensions.record_check.hysteresis import hysteresis_of, played
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal
from hybrid_sysid_ros.extensions.record_check.tests.records import RIG, ROOT, STEPS, driven_lag, record
from tests.command_line import refused


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


def test_an_unstable_law_whose_loop_nobody_names_is_said_to_be_one():
    rig = hs.load_rig("balancing_robot")
    held = bags.read(ROOT / "bags" / "balancing_robot_multisine", rig.signals)
    nameless = replace(rig, experiments=replace(rig.experiments, stabiliser=None))
    (found,) = [item for item in findings_of(held, nameless) if item.kind == "unstable law"]
    assert "an error grows by e in" in found.words
    assert "experiments.stabiliser" in found.cure


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


def test_a_guess_from_a_loop_s_record_may_be_the_feedback_s_inverse(call, tmp_path, monkeypatch):
    """A levitated magnet, x'' = a^2 x - b u, held by u = K x + D x' + a reference and a sensor's noise."""
    monkeypatch.chdir(tmp_path)
    random, step, x, v, rows = np.random.default_rng(0), 0.002, 0.0, 0.0, []
    wanted = lfilter([0.02], [1.0, -0.98], random.normal(size=4000))
    before = 0.0
    for k in range(4000):
        y = x + 1e-5 * random.normal()
        u = 60.0 * (y - 1e-3 * wanted[k]) + 1.0 * (y - before) / step
        before = y
        rows.append(f"{step * k:.3f},{u:.7f},{y:.9f}")
        v += step * (1600.0 * x - 60.0 * u)
        x += step * v
    (tmp_path / "held.csv").write_text("\n".join(["time [s],current [A],gap [m]", *rows]))
    program = partial(call, app.main, "hybrid-sysid")
    assert program("rig", "from", "held.csv", "./held", "--input", "current", "--output", "gap")[0] == 0
    assert program("import", "held.csv", "--rig", "./held")[0] == 0
    rig = hs.load_rig("./held")
    record = hs.read_bag("bags/held", rig)
    kinds = [item.kind for item in findings_of(record, rig)]
    assert "closed loop" in kinds
    assert "swapped channels" not in kinds
    model = hs.identify(record, rig, "gray", part=(0.0, 0.6))
    found = model.evaluate(record, part=(0.6, 1.0))
    assert found.uses["guessed_law"]["feedback"] == ["current answers gap"]
    assert not any(words.startswith("good") for words in found.judgement.values())


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
    expected = expected_outputs(r, rig)
    assert expected is not None
    assert acts_as_held(r, expected, every) is acts_as_held(replace(r, output=early), expected, every) is True
    assert acts_as_held(replace(r, output=np.roll(r.output, -8, axis=0)), expected, 20) is False


def test_levels_that_are_cut_off_were_applied_beyond_or_not_by_what_the_outputs_do():
    rig = hs.load_rig("flexible_joint")
    r = bags.read(ROOT / "bags" / "flexible_joint_random_steps", rig.signals)
    cut = replace(r, input=np.clip(r.input, 0.6 * r.input.min(), 0.6 * r.input.max()))
    found = findings_of(cut, rig)
    assert [item.kind for item in found] == ["clipped"]
    assert "torque stands at exactly" in found[0].words
    applied = expected_outputs(cut, rig)
    assert applied is not None
    noise = 0.003 * np.std(applied, axis=0) * np.random.default_rng(3).normal(size=applied.shape)
    assert findings_of(replace(cut, output=applied + noise), rig) == []


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
