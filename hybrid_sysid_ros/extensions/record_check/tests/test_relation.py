"""Outputs that are related to the inputs, and those that are not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_sysid_ros.extensions.record_check.relation import answers, wanders


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
