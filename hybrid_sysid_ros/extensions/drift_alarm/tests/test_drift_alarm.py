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


def watch(innovations, inputs=None):
    """The alarm after innovations (samples, 1) at RATE under inputs (samples, 1), by default ones that move."""
    inputs = np.arange(len(innovations))[:, None] if inputs is None else inputs
    model: Any = SimpleNamespace(system=SimpleNamespace(outputs=[SimpleNamespace(name="position")]))
    alarm = DriftAlarm(model, RATE)
    for row, applied in zip(innovations, inputs, strict=True):
        estimate: Any = SimpleNamespace(innovation=row, normalised=row**2)
        alarm.see(estimate, applied)
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


def test_a_loop_that_is_stopped_and_armed_again_begins_anew():
    """Its inputs rest in between, and its innovations are others there; neither is a drift of the loop that follows."""
    random = np.random.default_rng(2)
    calm, rest = random.normal(scale=0.4, size=(2000, 1)), random.normal(scale=0.1, size=(400, 1))
    moving, still = random.normal(size=(2000, 1)), np.zeros((400, 1))
    assert "have moved" in watch(np.concatenate([calm, calm + 0.5]), np.concatenate([moving, moving]))[0]
    stopped = [moving, moving, still, moving]
    assert watch(np.concatenate([calm, calm + 0.5, rest, calm]), np.concatenate(stopped))[0] == ""
    drifts = np.concatenate([calm, calm + 0.5, rest, calm, calm + 0.5])
    assert "have moved" in watch(drifts, np.concatenate([*stopped, moving]))[0]


def test_a_loop_that_begins_at_rest_raises_no_alarm_when_it_is_armed():
    random = np.random.default_rng(3)
    innovations = np.concatenate([random.normal(scale=0.1, size=(2000, 1)), random.normal(scale=0.4, size=(2000, 1))])
    inputs = np.concatenate([np.zeros((2000, 1)), random.normal(size=(2000, 1))])
    assert watch(innovations, inputs)[0] == ""
    assert "have grown" in watch(innovations)[0], "which it was before: the same innovations of a loop that moves"
