"""Faults that one signal shows by itself: wraps, spikes, sentinels, values beyond all numbers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.plateau import plateau_findings
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal, sample_findings
from hybrid_sysid_ros.extensions.record_check.tests.records import RIG, STEPS, driven_lag, record
from hybrid_sysid_ros.extensions.shared.sentinel import sentinel_of
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of, unwrapped, wraps_of


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
    assert (found.kind, "25 spikes" in found.words, "missing" in found.cure) == ("spikes", True, False)
    spiked[spiked > wandering + 1.0] = -50.0
    (found,) = sample_findings(signal(values=spiked))
    assert (found.kind, "missing" in found.cure) == ("spikes", True)
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


def test_a_sensor_with_noise_that_repeats_itself_froze_and_a_resonance_rings():
    random, k = np.random.default_rng(2), np.arange(2000)
    noisy = np.sin(0.003 * k) + 0.01 * random.normal(size=len(k))
    noisy[900:1000] = noisy[900]
    frozen = CheckedSignal(name="y", unit="K", values=noisy, period=300.0, is_input=False)
    (found,) = sample_findings(frozen)
    assert found.kind == "frozen"
    assert "2.97e+04 s from sample 901" in found.words
    assert frozen.spoilt.sum() == 99
    ringing = 1.5 * np.exp(-k / 60.0) * np.sin(2.0 * np.pi * k / 11.0) + 0.005 * random.normal(size=len(k))
    assert list(sample_findings(CheckedSignal(name="y", unit="m", values=ringing, period=1e-4, is_input=False))) == []


def test_an_input_and_a_coarse_output_that_froze_are_named_and_a_command_that_rests_is_not():
    """The rig goes on by the true input; where that rested, the output settles."""
    random = np.random.default_rng(0)
    smooth = lfilter([0.1], [1.0, -0.9], random.normal(size=len(STEPS)))
    stuck = slice(1010, 1600)

    def kinds(u, y):
        signal = partial(CheckedSignal, unit="1", period=0.1)
        item = signal(name="u", values=u, is_input=True), signal(name="y", values=y, is_input=False, noise=1e-4)
        return [[found.kind for found in plateau_findings(one, item)] for one in item]

    for u in (STEPS, smooth):
        held, y = u.copy(), driven_lag(u)
        held[stuck] = held[stuck.start]
        coarse = np.round(y / np.ptp(y) * 40.0)
        frozen = coarse.copy()
        frozen[stuck] = frozen[stuck.start]
        assert kinds(u, y) == kinds(u, coarse) == kinds(held, driven_lag(held)) == [[], []]
        assert kinds(held, y) == [["frozen"], []]
        assert kinds(u, frozen) == [[], ["frozen"]]
        held[stuck] = held[-1]
        assert kinds(held, y) == [[], []]
