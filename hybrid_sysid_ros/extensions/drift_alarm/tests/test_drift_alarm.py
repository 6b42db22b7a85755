"""A drift of the innovations is reported soon, and an undisturbed loop is accused as rarely as is stated."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.drift_alarm.cumulative_sum import SelfStartingSum, threshold_of
from hybrid_sysid_ros.extensions.drift_alarm.drift_alarm import DriftAlarm

RATE = 20.0


def steps_to_alarm(random, threshold, *, both, scale=1.0, mean=0.0, most=5000):
    """Values until an undisturbed sum crosses its threshold, whatever mean and deviation the values have."""
    found = SelfStartingSum(threshold, both=both)
    for count, value in enumerate(random.normal(mean, scale, size=most).tolist(), start=1):
        found.add(value)
        if found.crossed:
            return count
    return most


def test_an_undisturbed_process_is_accused_as_rarely_as_is_stated():
    """Mean and deviation are never given, and the first values have to show them."""
    random, length = np.random.default_rng(0), 200.0
    threshold = threshold_of(length)
    times = [steps_to_alarm(random, threshold, both=False, scale=7.0, mean=-3.0) for _ in range(300)]
    assert np.mean(times) == pytest.approx(length, rel=0.15)
    both = [steps_to_alarm(random, threshold, both=True) for _ in range(300)]
    assert np.mean(both) == pytest.approx(length / 2.0, rel=0.15)


def watch(innovations):
    """The alarm after innovations (samples, 1) at RATE."""
    model: Any = SimpleNamespace(system=SimpleNamespace(outputs=[SimpleNamespace(name="position")]))
    alarm = DriftAlarm(model, RATE)
    for row in innovations:
        estimate: Any = SimpleNamespace(innovation=row, normalised=row**2)
        alarm.see(estimate, np.zeros(1))
    return alarm.report()


@pytest.mark.parametrize(
    ("after", "words"),
    [(lambda z: z, ""), (lambda z: z + 0.5, "of position have moved"), (lambda z: 1.6 * z, "have grown")],
)
def test_a_drift_is_reported_by_what_moved(after, words):
    random = np.random.default_rng(1)
    calm, later = random.normal(scale=0.4, size=(4000, 1)), random.normal(scale=0.4, size=(1200, 1))
    found, values = watch(np.concatenate([calm, after(later)]))
    assert words in found
    assert bool(found) == bool(words)
    if found:
        at = float(found.split(" at ")[1].split(" s")[0])
        assert 200.0 < at < 230.0
    assert values["drift_false_alarm_hours"] == 10.0


def test_a_missing_reading_counts_for_nothing():
    found, values = watch(np.full((4000, 1), np.nan))
    assert found == ""
    assert values["drift_sum"] == 0.0
