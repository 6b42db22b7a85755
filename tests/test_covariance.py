"""How sure a fit is: the robust covariance against its double sum, and against repeated experiments."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_sysid_ros.identification.fitting import LONGEST_LAG, covariances


def by_double_sum(jacobian, residuals, edges, lags):
    """H^-1 (sum of w_k s_t s_{t+k}' within each record, and the priors) H^-1, as Newey and West print it."""
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    priors = jacobian[edges[-1] :]
    middle = priors.T @ priors
    for begin, end in pairwise(edges):
        scores = jacobian[begin:end] * residuals[begin:end, None]
        for i in range(len(scores)):
            for j in range(len(scores)):
                middle += max(0.0, 1 - abs(i - j) / (lags + 1)) * np.outer(scores[i], scores[j])
    return inverse @ middle @ inverse


def test_it_is_the_sum_of_newey_and_west_within_each_record():
    random = np.random.default_rng(0)
    edges = np.array([0, 40, 64, 120])
    jacobian, residuals = random.normal(size=(125, 3)), np.cumsum(random.normal(size=125)) / 5
    naive, robust = covariances(jacobian, residuals, edges)
    np.testing.assert_allclose(naive, np.linalg.inv(jacobian.T @ jacobian), rtol=1e-9)
    np.testing.assert_allclose(robust, by_double_sum(jacobian, residuals, edges, lags=24 // 4), rtol=1e-9)
    np.testing.assert_allclose(robust, robust.T)
    assert np.all(np.linalg.eigvalsh(robust) > 0)


def test_long_records_are_unrelated_after_the_longest_lag():
    random = np.random.default_rng(0)
    samples = 5 * LONGEST_LAG
    jacobian, residuals = random.normal(size=(samples, 1)), random.normal(size=samples)
    _, robust = covariances(jacobian, residuals, np.array([0, samples]))
    scores = jacobian[:, 0] * residuals
    correlation = np.correlate(scores, scores, mode="full")[samples - 1 :][: LONGEST_LAG + 1]
    weights = 1 - np.arange(LONGEST_LAG + 1) / (LONGEST_LAG + 1)
    weights[1:] *= 2
    assert robust[0, 0] == pytest.approx(weights @ correlation / np.sum(jacobian**2) ** 2, rel=1e-9)


def test_what_only_priors_know_keeps_their_deviations():
    random = np.random.default_rng(0)
    data = np.column_stack([random.normal(size=200), np.zeros(200)])
    jacobian = np.concatenate([data, np.diag([1 / 3.0, 1 / 0.05])])
    naive, robust = covariances(jacobian, random.normal(size=202), np.array([0, 200]))
    assert np.sqrt(naive[1, 1]) == pytest.approx(0.05, rel=1e-9)
    assert np.sqrt(robust[1, 1]) == pytest.approx(0.05, rel=1e-9)


def test_what_nothing_moves_has_no_error_and_spoils_no_other():
    random = np.random.default_rng(0)
    jacobian = np.column_stack([random.normal(size=200), np.zeros(200)])
    _, robust = covariances(jacobian, random.normal(size=200), np.array([0, 200]))
    assert robust[0, 0] > 0
    assert not np.any(robust[1])


RECORDS, SAMPLES, REPETITIONS = 4, 3000, 400
COEFFICIENTS = np.array([2.0, -1.0, 0.5])


@pytest.fixture(scope="module", params=[0.0, 0.9], ids=["white", "coloured"])
def repeated(request):
    """A linear regression repeated with errors of deviation 1 that remember: e(k) = a e(k - 1) + w(k). The regressors
    are a slow motion, a quick one and a constant. The cost takes the errors as unrelated, of deviation 1.
    """
    memory, random = request.param, np.random.default_rng(0)
    rows = RECORDS * SAMPLES
    slow = lfilter([1.0], [1.0, -0.95], random.normal(size=rows))
    regressors = np.column_stack([slow / np.std(slow), random.normal(size=rows), np.ones(rows)])
    edges = np.arange(RECORDS + 1) * SAMPLES
    estimates, naive, robust = [], [], []
    for _ in range(REPETITIONS):
        shocks = random.normal(size=(RECORDS, SAMPLES + 100)) * np.sqrt(1 - memory**2)
        errors = lfilter([1.0], [1.0, -memory], shocks, axis=1)[:, 100:].ravel()
        found = np.linalg.lstsq(regressors, regressors @ COEFFICIENTS + errors, rcond=None)[0]
        residuals = regressors @ (found - COEFFICIENTS) - errors
        covariance = covariances(regressors, residuals, edges)
        estimates.append(found)
        naive.append(np.sqrt(np.diag(covariance[0])))
        robust.append(np.sqrt(np.diag(covariance[1])))
    return memory, np.std(estimates, axis=0), np.mean(naive, axis=0), np.mean(robust, axis=0)


def test_robust_errors_are_those_of_repeated_experiments(repeated):
    """Within 20 %: the deviation of 400 estimates is itself known to 3.5 %, and long lags lose some of it."""
    _, deviations, _, robust = repeated
    np.testing.assert_allclose(robust, deviations, rtol=0.2)


def test_naive_errors_are_only_where_errors_are_white(repeated):
    """Under errors that remember, what moves slowly or not at all is known several times worse than the cost says."""
    memory, deviations, naive, _ = repeated
    ratios = deviations / naive
    if memory == 0.0:
        np.testing.assert_allclose(ratios, 1.0, atol=0.1)
    else:
        # A constant's variance grows by (1 + a) / (1 - a), a quick regressor's not at all.
        assert ratios[2] == pytest.approx(np.sqrt(1.9 / 0.1), rel=0.1)
        assert ratios[0] > 3.0
        assert ratios[1] == pytest.approx(1.0, abs=0.1)
