"""Every estimator where something goes wrong: numbers that are none, stamps out of order, gaps and outliers."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.estimators.moving_horizon_estimator import MovingHorizonEstimator
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_estimation import LINEAR, PERIOD, QUIET


@pytest.fixture
def running(kind):
    """A filter after a second of a steady beam, and its time."""
    ours = kind(LINEAR, dataclasses.replace(QUIET, gate=25.0), period=PERIOD)
    rest = np.array([LINEAR.centre])
    for k in range(201):
        estimate = ours.update(k * PERIOD, np.array([0.0]), rest)
    return ours, estimate, 200 * PERIOD, rest


def unchanged(a, b):
    np.testing.assert_array_equal(a.state, b.state)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    np.testing.assert_array_equal(a.disturbance, b.disturbance)


def test_the_first_measurement_must_be_a_number(kind):
    ours = kind(LINEAR, QUIET, period=PERIOD)
    with pytest.raises(UserError, match=r"the first measurement .* is not a number"):
        ours.update(0.0, np.array([np.nan]), np.zeros(1))
    assert ours.counters.invalid == 1
    assert ours.update(PERIOD, np.array([0.02]), np.zeros(1)).state[0] == 0.02


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_measurement_that_is_no_number_is_counted_and_predicted_over(running, value):
    ours, _, t, rest = running
    estimate = ours.update(t + PERIOD, np.array([value]), rest)
    assert ours.counters.invalid == 1
    assert ours.counters.updates == 201
    assert np.isnan(estimate.normalised_innovation)
    assert estimate.time == t + PERIOD
    assert abs(estimate.state[0]) < 1e-4
    assert np.all(np.isfinite(estimate.covariance))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, -1e20])
def test_an_input_that_no_rig_has_is_the_one_before(running, value):
    ours, _, t, _ = running
    estimate = ours.update(t + PERIOD, np.array([0.0]), np.array([value]))
    assert (ours.counters.unknown_inputs, ours.counters.invalid) == (1, 0)
    assert ours.counters.updates == 202
    assert abs(estimate.state[1]) < 1e-3


@pytest.mark.parametrize("back", [0.0, 0.005, 0.5, 1e9])
def test_a_measurement_that_is_late_or_repeated_is_ignored(running, back):
    ours, before, t, rest = running
    estimate = ours.update(t - back, np.array([0.3]), rest)
    assert ours.counters.late == 1
    assert estimate.time == t
    unchanged(estimate, before)


def test_missing_measurements_are_counted_by_the_stamps(running):
    ours, _, t, rest = running
    ours.update(t + 4 * PERIOD, np.array([0.0]), rest)
    assert ours.counters.missing == 3
    ours.update(t + 5.02 * PERIOD, np.array([0.0]), rest)  # a late wake-up is no gap
    assert ours.counters.missing == 3


def test_an_outlier_is_counted_and_not_believed(running):
    ours, _, t, rest = running
    estimate = ours.update(t + PERIOD, np.array([0.1]), rest)
    assert ours.counters.gated == 1
    assert estimate.normalised_innovation > 25.0
    assert abs(estimate.state[0]) < 1e-4
    ours.update(t + 2 * PERIOD, np.array([0.0]), rest)
    assert ours.counters.resets == 0


def test_a_run_of_outliers_wins_in_the_end(running):
    """The beam was moved by hand: after six measurements of it the filter starts afresh, its disturbance kept."""
    ours, before, t, rest = running
    for k in range(1, 7):
        assert abs(ours.update(t + k * PERIOD, np.array([0.1]), rest).state[0] - 0.1) < (0.11 if k < 6 else 1e-12)
    assert (ours.counters.gated, ours.counters.resets) == (6, 1)
    estimate = ours.update(t + 7 * PERIOD, np.array([0.1]), rest)
    assert estimate.state[0] == pytest.approx(0.1, abs=2e-3)
    assert estimate.disturbance[0] == pytest.approx(before.disturbance[0], abs=0.05)


def test_after_a_long_gap_it_starts_afresh(running):
    ours, _, t, rest = running
    estimate = ours.update(t + 30.0, np.array([0.07]), rest)
    assert ours.counters.resets == 1
    np.testing.assert_array_equal(estimate.state, [0.07, 0.0])


def test_a_stamp_in_the_far_future_without_a_number_does_not_hold_the_filter_up(running):
    """From simulated time to the clock's: nothing to predict over half a century of, and nothing to start from."""
    ours, before, _, rest = running
    estimate = ours.update(1.7e9, np.array([np.nan]), rest)
    assert ours.counters.invalid == 1
    unchanged(estimate, before)
    following = ours.update(1.7e9 + PERIOD, np.array([0.05]), rest)
    np.testing.assert_array_equal(following.state, [0.05, 0.0])
    assert following.time == 1.7e9 + PERIOD


def test_rubbish_in_any_order_leaves_a_working_filter(kind, rig):
    """NaN, outliers, gaps, repeats and steps back, at random, and then the truth."""
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    ours = kind(rig.system, tuning, period=PERIOD, latency=0.001)
    random = np.random.default_rng(0)
    ours.update(0.0, np.zeros(1), np.ones(1))
    t = 0.0
    for _ in range(3000):
        t += random.choice([PERIOD, 2 * PERIOD, 0.3, 2.0, 0.0, -0.1], p=[0.6, 0.1, 0.1, 0.05, 0.1, 0.05])
        y = random.choice([0.0, 1e3, -1e12, np.nan, np.inf, 0.1])
        estimate = ours.update(t, np.array([y]), np.array([random.choice([0.0, 10.0, np.nan, np.inf])]))
        for value in (estimate.state, estimate.ahead, estimate.disturbance, estimate.covariance):
            assert np.all(np.isfinite(value))
    t = max(t, estimate.time)
    for k in range(1, 1500):
        estimate = ours.update(t + k * PERIOD, np.array([0.02]), np.array([rig.system.centre]))
    assert estimate.state[0] == pytest.approx(0.02, abs=2e-3)
    assert abs(estimate.state[1]) < 0.02
    counters = ours.counters
    assert min(counters.late, counters.missing, counters.invalid, counters.gated, counters.resets) > 0


def test_a_disturbance_is_bounded(kind):
    ours = kind(LINEAR, dataclasses.replace(QUIET, disturbance_limit=(0.5,)), period=PERIOD)
    for k in range(2000):
        estimate = ours.update(k * PERIOD, np.array([0.3 * k * PERIOD]), np.array([LINEAR.centre]))
    assert estimate.disturbance[0] == pytest.approx(0.5)


def test_an_estimate_is_not_the_filter_s_own_memory(running):
    ours, before, t, rest = running
    kept = before.state.copy()
    ours.update(t + PERIOD, np.array([0.001]), rest)
    np.testing.assert_array_equal(before.state, kept)
    before.covariance[:] = np.nan
    assert np.all(np.isfinite(ours.update(t + 2 * PERIOD, np.zeros(1), rest).covariance))


def test_reset_forgets_everything(running):
    ours, _, _, rest = running
    ours.reset()
    estimate = ours.update(0.0, np.array([0.04]), rest)
    np.testing.assert_array_equal(estimate.state, [0.04, 0.0])
    assert estimate.time == 0.0


def test_a_loosened_estimate_stays_and_doubts_itself(running, kind):
    """A sensor that lied has a part in it, so that the others must be believed more than before."""
    ours, before, t, rest = running
    ours.loosen()
    estimate = ours.update(t + PERIOD, np.array([0.0]), rest)
    assert estimate.state == pytest.approx(before.state, abs=1e-3)
    if kind is not MovingHorizonEstimator:  # which computes its deviations anew from its horizon
        assert np.all(np.diag(estimate.covariance) > np.diag(before.covariance))
