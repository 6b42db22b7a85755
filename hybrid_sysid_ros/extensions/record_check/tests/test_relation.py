"""Outputs that are related to the inputs, and those that are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.extensions.record_check.alignment import beyond_chance, time_of_change
from hybrid_sysid_ros.extensions.record_check.check import findings_of
from hybrid_sysid_ros.extensions.record_check.correction import straightness_of_offsets
from hybrid_sysid_ros.extensions.record_check.relation import answers, is_early, wanders
from hybrid_sysid_ros.extensions.record_check.tests.records import RIG, ROOT, STEPS, driven_lag, record


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


@pytest.mark.parametrize("seed", range(3))
def test_what_is_quantised_or_rough_and_follows_nothing_is_unrelated_first(seed):
    """Noise and quantisation weaken a relation, which stays above chance."""
    random, r, rig = np.random.default_rng(seed), record(), hs.load_rig(RIG)
    white = random.normal(size=r.samples)
    slow = lfilter([0.02], [1.0, -0.98], white)
    size, count = np.std(r.output), np.ptp(r.output) / 40.0
    for other in (size * white, np.round(size / np.std(slow) * slow / count) * count):
        assert findings_of(replace(r, output=other[:, None]), rig)[0].kind == "no relation"
    for weak in (r.output + size * white[:, None], np.round(r.output / (4.0 * count)) * 4.0 * count):
        assert "no relation" not in [item.kind for item in findings_of(replace(r, output=weak), rig)]


def test_noise_that_hides_changes_hides_no_relation():
    """A heading, whose changes within a time of change are small beside white noise, and a walk that is another's."""
    heading = np.cumsum(lfilter([0.05], [1.0, -0.95], STEPS - np.mean(STEPS)))
    noise = np.random.default_rng(0).normal(size=len(STEPS))
    other = np.cumsum(driven_lag(np.random.default_rng(5).permutation(STEPS)))
    good, apart = np.ones(len(STEPS), dtype=bool), time_of_change(heading)
    assert beyond_chance(heading + 0.5 * np.std(heading) * noise, heading, good, apart, 80)
    for unrelated in (noise, other, np.convolve(noise, np.ones(31), mode="same")):
        assert not beyond_chance(unrelated, heading, good, apart, 80)


@pytest.mark.parametrize("early", [4, 20])
def test_an_output_that_moves_before_its_input_is_early_and_a_slow_one_is_not(early):
    steps = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 150), 30)
    slow = driven_lag(steps)
    assert is_early(steps[:, None], np.roll(slow, -early))
    assert not is_early(steps[:, None], slow)
    assert not is_early(steps[:, None], driven_lag(slow))


def test_what_grew_as_much_as_its_noise_is_scaled_and_what_is_only_noisier_is_not():
    """From a first state a thousand times too large the physics went beyond all that the record shows."""
    rig = hs.load_rig("flexible_joint")
    r = bags.read(ROOT / "bags" / "flexible_joint_random_steps", rig.signals)
    noise = 0.1 * np.std(r.output, axis=0) * np.random.default_rng(0).normal(size=r.output.shape)
    assert findings_of(replace(r, output=r.output * [1.0, 1000.0]), rig)[0].kind == "scale"
    assert {item.kind for item in findings_of(replace(r, output=r.output + noise), rig)} == {"noise"}


def test_what_an_offset_adds_is_a_line_where_a_law_integrates():
    rig = hs.load_rig("flexible_joint")
    r = bags.read(ROOT / "bags" / "flexible_joint_random_steps", rig.signals)
    assert straightness_of_offsets(r, rig, "motor_angle") > 0.9
    assert straightness_of_offsets(r, rig, "link_speed") < 0.5
