"""Information criteria against published formulas, autocorrelation times against closed forms."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture.criteria import autocorrelation_time, criteria, judge


def coloured(seed, pole, samples):
    noise = np.random.default_rng(seed).normal(size=samples + 500)
    return lfilter([1.0], [1.0, -pole], noise)[500:]


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9, 0.97])
def test_the_time_of_a_first_order_colour_is_its_closed_form(pole):
    samples, tau = 400_000, (1 + pole) / (1 - pole)
    deviation = np.sqrt(2 * (2 * 5 * tau + 1) / samples)  # relative, of the windowed sum: Sokal (1997)
    assert autocorrelation_time([coloured(1, pole, samples)]) == pytest.approx(tau, rel=3 * deviation)


def test_the_time_of_a_moving_average_is_its_closed_form():
    # e(t) = w(t) + w(t - 1) + w(t - 2): r(1) = 2/3, r(2) = 1/3, so tau = 1 + 2 (2/3 + 1/3) = 3
    white = np.random.default_rng(2).normal(size=300_000)
    assert autocorrelation_time([white[2:] + white[1:-1] + white[:-2]]) == pytest.approx(3.0, rel=0.03)


def test_means_of_residuals_scatter_as_the_effective_number_says():
    means = [coloured(seed, 0.8, 2000).mean() for seed in range(800)]
    deviation = 1 / np.sqrt(1 - 0.8**2)
    samples = (deviation / np.std(means)) ** 2
    assert 2000 / autocorrelation_time([coloured(9, 0.8, 100_000)]) == pytest.approx(samples, rel=0.15)


def test_records_are_not_correlated_with_one_another():
    parts = [coloured(seed, 0.9, 4000) for seed in range(60)]
    assert autocorrelation_time(parts) == pytest.approx(19.0, rel=0.1)
    shifted = [part + 5.0 * sign for part, sign in zip(parts, [1.0, -1.0] * 30, strict=True)]
    assert autocorrelation_time(shifted) == pytest.approx(autocorrelation_time(parts))  # nor are their means


def test_samples_are_never_worth_more_than_they_are():
    assert autocorrelation_time([np.tile([1.0, -1.0], 500)]) == 1.0


def test_the_criteria_are_the_published_formulas():
    n, mean_square, p = 40, 0.3, 4
    found = criteria(mean_square, n, p)
    residuals = np.random.default_rng(3).normal(size=n)
    residuals *= np.sqrt(mean_square / np.mean(residuals**2))
    log_likelihood = norm.logpdf(residuals, scale=np.sqrt(mean_square)).sum()
    constant = n * (1 + np.log(2 * np.pi))
    assert found.aic + constant == pytest.approx(-2 * log_likelihood + 2 * (p + 1))
    assert found.bic + constant == pytest.approx(-2 * log_likelihood + (p + 1) * np.log(n))
    # Hurvich and Tsai (1989), Biometrika 76(2): n (ln s2 + 1) + ... for p coefficients of a regression
    assert found.aicc == pytest.approx(n * np.log(mean_square) + n * (1 + p / n) / (1 - (p + 2) / n) - n)
    # Akaike's FPE, as Ljung (1999) writes it in 16.4: 1/N sum e^2 (1 + d/N) / (1 - d/N)
    assert found.fpe == pytest.approx(0.3 * 44 / 36)


def test_too_many_parameters_cost_everything():
    found = criteria(1.0, 5.0, 5)
    assert found.aicc == np.inf
    assert found.fpe == np.inf


def test_the_right_order_of_a_regression_is_chosen():
    random = np.random.default_rng(4)
    x = np.linspace(-1, 1, 400)
    y = 1 - 2 * x + 1.5 * x**3 + 0.3 * random.normal(size=400)
    models = {}
    for order in range(9):
        residuals = y - np.polynomial.Polynomial.fit(x, y, order)(x)
        models[str(order)] = ([residuals], order + 1)
    found = judge(models)
    assert min(found, key=lambda name: found[name].plain.bic) == "3"
    assert min(found, key=lambda name: found[name].effective.bic) == "3"


def test_correlated_residuals_do_not_buy_parameters():
    """A term that a slow noise alone explains: the plain count takes it, the effective one does not."""
    taken = {"plain": 0, "effective": 0}
    times = np.arange(8000) / 8000
    for seed in range(200):
        y = coloured(seed, 0.97, 8000)
        basis = np.cos(2 * np.pi * 3 * times)
        left = y - basis * (basis @ y) / (basis @ basis)
        found = judge({"without": ([y], 0), "with": ([left], 1)})
        for count in taken:
            taken[count] += getattr(found["with"], count).aic < getattr(found["without"], count).aic
    # With independent residuals a useless term is taken where chi2 with 1 degree exceeds 2: 15.7 % of the time.
    assert taken["plain"] > 120
    assert taken["effective"] < 50


def test_all_models_are_judged_by_the_time_of_the_best():
    good, bad = coloured(5, 0.5, 5000), 10 * coloured(6, 0.99, 5000)
    found = judge({"bad": ([bad], 2), "good": ([good[:2000], good[2000:]], 9)})
    assert found["bad"].effective.samples == found["good"].effective.samples == pytest.approx(5000 / 3, rel=0.15)
    assert found["good"].plain.samples == 5000


@pytest.mark.parametrize(
    ("models", "match"),
    [
        ({}, "no model"),
        ({"a": ([np.ones(5)], 1), "b": ([np.ones(6)], 1)}, "same data"),
        ({"a": ([np.ones(5)], 1)}, "constant"),
        ({"a": ([np.array([1.0, np.nan])], 1)}, "not finite"),
    ],
)
def test_what_cannot_be_judged_is_refused(models, match):
    with pytest.raises(UserError, match=match):
        judge(models)
