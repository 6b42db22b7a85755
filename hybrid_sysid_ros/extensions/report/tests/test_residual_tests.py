"""Residual tests against closed forms, numpy and scipy: they see what is left, and nothing else."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from hybrid_sysid_ros.extensions.shared.residual_tests import (
    DESCRIPTIONS,
    correlation_tests,
    independence,
    whiteness,
)
from hybrid_sysid_ros.support.errors import UserError

SAMPLES = 800


def white(seed, samples=SAMPLES):
    return np.random.default_rng(seed).normal(size=samples)


def coloured(seed, pole, samples=SAMPLES):
    return lfilter([1.0], [1.0, -pole], white(seed, samples + 200))[200:]


def rate(passes):
    """Share of passes, and its standard deviation if the true one is 99 %."""
    return np.mean(passes), np.sqrt(0.99 * 0.01 / len(passes))


def test_coefficients_are_those_of_numpy():
    e, u = coloured(1, 0.5), coloured(2, 0.8)
    test = whiteness(e, lags=10)
    centred = e - e.mean()
    expected = [np.dot(centred[k:], centred[:-k]) / np.dot(centred, centred) for k in range(1, 11)]
    np.testing.assert_allclose(test.values, expected, rtol=1e-10)
    test = independence(e, u, lags=3)
    v = u - u.mean()
    sums = [np.dot(centred[:-2], v[2:]), np.dot(centred, v), np.dot(centred[2:], v[:-2])]
    np.testing.assert_allclose(test.values[[1, 3, 5]], sums / (SAMPLES * e.std() * u.std()), rtol=1e-9)
    np.testing.assert_array_equal(test.lags, np.arange(-3, 4))


def test_the_statistic_of_four_samples_by_hand():
    # r(1) = ((-1)(1) + (1)(-1) + (-1)(1)) / 4 = -3/4, r(2) = 2/4: Q = 4 * 6 * (9/16 / 3 + 1/4 / 2) = 7.5
    test = whiteness(np.array([1.0, -1.0, 1.0, -1.0]), lags=2)
    assert test.statistic == pytest.approx(7.5)
    assert test.p_value == pytest.approx(chi2.sf(7.5, 2))
    assert test.bound == pytest.approx(2.5758293 / 2)


def test_white_noise_passes_at_the_stated_rate():
    tests = [whiteness(white(seed)) for seed in range(1000)]
    passed, deviation = rate([test.passed for test in tests])
    assert abs(passed - 0.99) < 4 * deviation
    outside = np.mean([test.outside / len(test.lags) for test in tests])
    assert outside == pytest.approx(0.01, abs=0.003)


def test_a_first_order_colour_fails_and_has_its_coefficients():
    test = whiteness(coloured(3, 0.9, 200_000), lags=20)
    assert not test.passed
    np.testing.assert_allclose(test.values, 0.9 ** np.arange(1, 21), atol=0.03)
    assert not whiteness(coloured(4, 0.3), lags=20).passed


@pytest.mark.parametrize(("residual_pole", "input_pole"), [(0.0, 0.0), (0.9, 0.0), (0.0, 0.9), (0.8, 0.8)])
def test_what_the_input_does_not_explain_passes_whatever_its_colour(residual_pole, input_pole):
    tests = [
        independence(coloured(seed, residual_pole), coloured(10_000 + seed, input_pole), lags=20) for seed in range(600)
    ]
    outside = np.mean([test.outside / len(test.lags) for test in tests])
    assert outside == pytest.approx(0.01, abs=0.006)
    passed, _ = rate([test.passed for test in tests])
    assert passed == pytest.approx(0.99, abs=0.02)


def test_the_bound_is_the_closed_form_of_two_first_order_colours():
    # correlations a^|k| and b^|k|: sum of a^|k| b^|k| = (1 + a b) / (1 - a b)
    samples = 100_000
    test = independence(coloured(5, 0.9, samples), coloured(6, 0.7, samples))
    assert test.bound == pytest.approx(2.5758293 * np.sqrt((1 + 0.63) / (1 - 0.63) / samples), rel=0.05)


def test_a_delayed_input_shows_at_its_lag():
    u = white(7)
    e = white(8) + 0.5 * np.concatenate([np.zeros(6), u[:-6]])
    test = independence(e, u)
    assert not test.passed
    assert test.lags[np.argmax(np.abs(test.values))] == 6
    assert test.values[test.lags == 6][0] == pytest.approx(0.5 / np.sqrt(1.25), abs=0.08)
    assert test.outside <= 3


def test_feedback_shows_at_negative_lags_only():
    tests = []
    for seed in range(20):
        e = white(seed)
        tests.append(independence(e, white(100 + seed) - 0.5 * np.concatenate([np.zeros(2), e[:-2]])))
    assert all(test.lags[np.argmax(np.abs(test.values))] == -2 for test in tests)
    assert sum(test.passed for test in tests) >= 18


def test_an_input_without_power_at_some_frequencies_is_judged_where_it_has_some():
    t = np.arange(SAMPLES)
    sines = np.sin(0.2 * t) + np.sin(0.31 * t)
    test = independence(white(11), sines)
    assert test.degrees < len(test.lags)
    assert test.passed
    assert not independence(white(11) + 0.5 * np.cos(0.2 * t), sines).passed


@pytest.mark.parametrize(
    ("residuals", "match"),
    [
        (np.ones(SAMPLES), "constant"),
        (white(0, 30), "too few"),
        (np.where(np.arange(SAMPLES) == 17, np.nan, 1.0), "not finite at sample 17"),
    ],
)
def test_residuals_that_cannot_be_tested_are_refused(residuals, match):
    with pytest.raises(UserError, match=match):
        whiteness(residuals)
    with pytest.raises(UserError, match=match):
        independence(residuals, white(1, len(residuals)))


def left_over(seed, samples=4000):
    """White residuals and an independent white input."""
    return white(seed, samples), white(seed + 50_000, samples)


def delayed(signal, lag):
    return np.concatenate([np.zeros(lag), signal[:-lag]])


def test_the_five_tests_are_the_sums_of_their_definitions():
    e, u = white(21, 300), 1.0 + coloured(22, 0.6, 300)
    tests = correlation_tests(e, u, lags=3)
    assert list(tests) == list(DESCRIPTIONS)
    e, u = e - e.mean(), u - u.mean()
    pairs = {"phi_ue": (e, u), "phi_e(eu)": (e, e * u), "phi_(u^2)'e": (e, u**2), "phi_(u^2)'e^2": (e**2, u**2)}
    for name, (first, second) in pairs.items():
        a, b = first - first.mean(), second - second.mean()
        for lag in range(4):
            plain = sum(a[t] * b[t - lag] for t in range(lag, 300)) / 300 / (a.std() * b.std())
            assert tests[name].values[tests[name].lags == lag][0] == pytest.approx(plain, rel=1e-9), (name, lag)


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_the_unit_of_the_residuals_does_not_matter(unit):
    e, u = white(21, 300), white(22, 300)
    for name, test in correlation_tests(unit * e, u, lags=3).items():
        np.testing.assert_allclose(test.values, correlation_tests(e, u, lags=3)[name].values, atol=1e-9)


def test_nothing_left_passes_all_five_at_the_stated_rate():
    tests = [correlation_tests(*left_over(seed, 1000), lags=20) for seed in range(300)]
    for name in DESCRIPTIONS:
        passed, deviation = rate([test[name].passed for test in tests])
        assert passed > 0.99 - 4 * deviation, name


@pytest.mark.parametrize(
    ("missing", "failing"),
    [
        (lambda e, u: 0.3 * delayed(u, 2), {"phi_ue", "phi_(u^2)'e^2"}),
        (lambda e, u: 0.3 * delayed(u**2 - 1, 2), {"phi_(u^2)'e", "phi_(u^2)'e^2"}),
        (lambda e, u: 0.2 * delayed(u**3 - 3 * u, 2), {"phi_(u^2)'e^2"}),  # odd and without a linear part: Hermite's
        (lambda e, u: 0.4 * delayed(u, 1) * delayed(e, 1), {"phi_e(eu)", "phi_(u^2)'e^2"}),
    ],
    ids=["linear", "even", "odd", "bilinear noise"],
)
def test_each_missing_term_fails_its_own_tests(missing, failing):
    e, u = left_over(31)
    tests = correlation_tests(e + missing(e, u), u)
    failed = {name for name, test in tests.items() if test.p_value < 1e-4}
    assert failed - {"phi_ee"} == failing


def test_a_binary_input_has_no_square():
    e, _ = left_over(41)
    balanced = np.tile([1.0, -1.0, -1.0, 1.0], 1000)
    assert list(correlation_tests(e, balanced)) == ["phi_ee", "phi_ue", "phi_e(eu)"]


def test_different_lengths_are_refused_by_all_five():
    with pytest.raises(UserError, match="800 residuals, but 700"):
        correlation_tests(white(1), white(2, 700))
