"""How sure a fit is: the robust covariance against its double sum, and against repeated experiments."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_sysid_ros.core import System, bounded, simulate
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.identification import fitting
from hybrid_sysid_ros.identification.experiment import resample
from hybrid_sysid_ros.identification.standard_errors import (
    LONGEST_LAG,
    block_spread,
    confidence,
    covariances,
    long_run,
    secant_jacobian,
    widening,
)
from hybrid_sysid_ros.models import Sampling
from tests.linear_bench import record_of
from tests.small_systems import Slider


def by_double_sum(jacobian, residuals, edges, lags):
    """The sum of w_k s_t s_{t+k}' within each record, as Newey and West print it."""
    middle = np.zeros((jacobian.shape[1], jacobian.shape[1]))
    for (begin, end), longest in zip(pairwise(edges), lags, strict=True):
        scores = jacobian[begin:end] * residuals[begin:end, None]
        for i in range(len(scores)):
            for j in range(len(scores)):
                middle += max(0.0, 1 - abs(i - j) / (longest + 1)) * np.outer(scores[i], scores[j])
    return middle


def test_it_is_the_sum_of_newey_and_west_within_each_record():
    random = np.random.default_rng(0)
    edges = np.array([0, 40, 64, 120])
    jacobian, residuals = random.normal(size=(125, 3)), np.cumsum(random.normal(size=125)) / 5
    naive, robust = covariances(jacobian, residuals, edges)
    np.testing.assert_allclose(naive, np.linalg.inv(jacobian.T @ jacobian), rtol=1e-9)
    lags = np.array([10, 6, 14])
    found = long_run(jacobian, residuals, edges, lags)
    np.testing.assert_allclose(found, by_double_sum(jacobian, residuals, edges, lags), rtol=1e-9)
    np.testing.assert_allclose(robust, robust.T)
    assert np.all(np.linalg.eigvalsh(robust) > 0)


@pytest.mark.parametrize("life", [0.0, 60.0, 600.0])
def test_errors_that_live_longer_than_the_lags_count(life):
    """Of a level and a slope by steps, over 100 draws of noise and a gust that lives for so many samples.

    90 % intervals hold in 75 % at least, even of gusts that live as long as the record; by the lags alone in 45 %.
    """
    samples, truth = 800, []
    random, fade = np.random.default_rng(0), np.exp(-1.0 / life) if life else 0.0
    jacobian = np.column_stack([np.ones(samples), np.repeat(random.choice([-1.0, 1.0], samples // 20), 20)])
    gusts = lfilter([np.sqrt(1.0 - fade**2)], [1.0, -fade], random.normal(size=(100, 6000)))[:, -samples:]
    for gust in gusts:
        errors = (gust if life else 0.0) + 0.3 * random.normal(size=samples)
        found = np.linalg.lstsq(jacobian, errors)[0]
        _, robust = covariances(jacobian, errors - jacobian @ found, np.array([0, samples]))
        truth.append(np.abs(found) / np.sqrt(np.diag(robust)) < 1.645)
    level, slope = np.mean(truth, axis=0)
    assert level > 0.75
    assert 0.8 < slope < 0.99


def test_long_records_are_unrelated_after_the_longest_lag():
    random = np.random.default_rng(0)
    samples = 5 * LONGEST_LAG
    jacobian, residuals = random.normal(size=(samples, 1)), random.normal(size=samples)
    _, robust = covariances(jacobian, residuals, np.array([0, samples]))
    scores = jacobian[:, 0] * residuals
    correlation = np.correlate(scores, scores, mode="full")[samples - 1 :][: LONGEST_LAG + 1]
    weights = 1 - np.arange(LONGEST_LAG + 1) / (LONGEST_LAG + 1)
    weights[1:] *= 2
    expected = (
        weights @ correlation / np.sum(jacobian**2) ** 2 * widening(np.array([0, samples]), np.array([LONGEST_LAG]))
    )
    assert robust[0, 0] == pytest.approx(expected, rel=1e-9)


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


def test_errors_are_widened_for_short_records_only():
    """To the quantile of Student's distribution of 1.5 N / L degrees, and by what the fit took of the scores."""
    assert widening(np.array([0, 10**6]), np.array([0])) == pytest.approx(1.0, abs=1e-4)
    assert widening(np.array([0, 400, 800]), np.array([99, 99])) == pytest.approx(
        (1.782 / 1.645) ** 2 / (1 - 100 / 800), rel=2e-3
    )


def test_two_that_act_as_one_are_unknown_and_a_third_is_not():
    random = np.random.default_rng(0)
    one, other = random.normal(size=(2, 200))
    _, robust = covariances(np.column_stack([one, other, 2.0 * one]), random.normal(size=200), np.array([0, 200]))
    assert not np.any(robust[[0, 2]])
    assert robust[1, 1] == pytest.approx(covariances(other[:, None], one, np.array([0, 200]))[1][0, 0], rel=1.0)
    assert robust[1, 1] > 0


def test_a_known_error_of_the_rows_adds_what_it_moves():
    """A constant error of the rows moves a mean by itself, and a slope about it by nothing."""
    slope = np.linspace(-1.0, 1.0, 101)
    jacobian, residuals = np.column_stack([np.ones(101), slope]), np.random.default_rng(0).normal(size=101)
    edges = np.array([0, 101])
    without = covariances(jacobian, residuals, edges)[1]
    added = covariances(jacobian, residuals, edges, shifts=np.full((1, 101), 0.3))[1] - without
    np.testing.assert_allclose(added, [[0.09, 0.0], [0.0, 0.0]], atol=1e-12)


def test_an_anchor_counts_with_the_covariance_of_the_earlier_fit():
    """A parameter that rests on a prior alone is known as well as the prior's centre is."""
    jacobian = np.concatenate([np.zeros((50, 1)), [[1 / 3.0]]])
    robust = covariances(jacobian, np.zeros(51), np.array([0, 50]), priors=np.array([[4.0]]))[1]
    assert robust[0, 0] == pytest.approx(4.0 * 9.0)


def test_a_corner_does_not_make_a_parameter_known():
    """Rows that jump at one value of the parameter: their derivative there is a thousand times that of the way."""
    random = np.random.default_rng(0)
    noise, edges = random.normal(size=400), np.array([0, 400])

    def rows(point):
        return 0.1 * point[0] + 100.0 * np.clip(point[0], -1e-3, 1e-3) * (np.arange(400) == 7) + noise

    exact = np.full((400, 1), 0.1)
    exact[7] = 100.1
    assert np.sqrt(covariances(exact, rows(np.zeros(1)), edges)[1][0, 0]) < 0.05
    jacobian = secant_jacobian(rows, np.zeros(1), exact, edges)
    assert np.sqrt(covariances(jacobian, rows(np.zeros(1)), edges)[1][0, 0]) == pytest.approx(0.5, rel=0.4)


def test_errors_smaller_than_expected_may_weigh_more():
    """White errors of a tenth of what the cost takes them for: by a factor of ten."""
    random = np.random.default_rng(0)
    jacobian, residuals = random.normal(size=(4000, 5)), 0.1 * random.normal(size=4000)
    assert confidence(jacobian, residuals, np.array([0, 2000, 4000])) == pytest.approx(10.0, rel=0.15)


def test_a_hum_whose_periods_fit_into_the_samples_is_seen_as_an_offset():
    """60 Hz at 20 samples a second: the sine of its phase, in each record."""
    time = np.arange(20001) * 0.001
    record = record_of(np.ones((20001, 1)), (np.sin(time) + 0.1 * np.sin(2 * np.pi * 60 * time + 1.0))[:, None], 0.001)
    assert resample(record, Sampling()).alias[0] == pytest.approx(0.1 * np.sin(1.0), rel=0.02)
    assert abs(resample(record, Sampling(step=0.001, period=0.045)).alias[0]) < 1e-3


@dataclass(frozen=True, kw_only=True)
class Lag(System):
    """T y' = gain u + centre - y."""

    states = ("y [m]",)
    inputs = ("u [V]",)
    gain: float = bounded(0.5, 0.0, 5.0, unit="m/V")
    """Per input."""
    centre: float = bounded(0.0, -5.0, 5.0, unit="m")
    """Where it rests."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return ((self.gain * u[0] + self.centre - x[0]) / 0.2,)


@pytest.mark.parametrize("period", [0.045, 0.05])
def test_a_motion_in_time_with_the_samples_is_no_hum(period):
    """What an input moves at that frequency, a motion that begins with the record, and a drift are motions."""
    time, noise = np.arange(8001) * 0.001, 1e-4 * np.random.default_rng(2).normal(size=8001)
    driven, square = np.sin(2 * np.pi * time / period + 1.0), np.sign(np.sin(2 * np.pi * time + 1e-9))
    for inputs in (np.sin(time) + driven, square, 0.0 * time + square[::-1]):
        outputs = lfilter([1 - np.exp(-0.02)], [1, -np.exp(-0.02)], inputs) + 0.1 * time + noise
        record = record_of(inputs[:, None], outputs[:, None], 0.001)
        assert abs(resample(record, Sampling(step=0.001, period=period)).alias[0]) < 1e-5


def test_a_fit_follows_what_is_below_an_aliased_hum():
    """The offset is known from the samples between: a place of rest is not moved by it."""
    steps, noise = np.repeat(np.random.default_rng(0).uniform(-1, 1, 20), 1000), np.random.default_rng(1)
    exact = lfilter([1 - np.exp(-0.005)], [1, -np.exp(-0.005)], steps + 0.3)
    clean = np.concatenate([[0.0], exact]) + 0.001 * noise.normal(size=20001)
    hum = 0.1 * np.sin(2 * np.pi * 60 * np.arange(20001) * 0.001 + 1.0)
    inputs = np.concatenate([steps, steps[-1:]])[:, None]
    found = []
    for output in (clean, clean + hum):
        experiment = resample(record_of(inputs, output[:, None], 0.001), Sampling()).experiment(Lag())
        fitted = fitting.fit(Lag(), [experiment])
        found.append((fitted.system.named["centre"], float(np.sqrt(fitted.covariance[1, 1]))))
    assert found[0][0] == pytest.approx(0.3, abs=2e-3)
    assert found[1][0] == pytest.approx(found[0][0], abs=2e-3)
    assert found[1][1] < 5e-3


@dataclass(frozen=True, kw_only=True)
class Useless(Slider):
    """A block on a table, and a number that acts on nothing."""

    useless: float = bounded(1.0, -5.0, 5.0, unit="m/s^2")
    """Of no use."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0] + 0.0 * self.useless


def test_searches_that_leave_a_number_where_it_is_do_not_make_it_known():
    system, inputs = Useless(), 6.0 * np.sign(np.sin(np.arange(4000) * 0.005))[:, None]
    states = simulate(system, np.zeros(2), inputs[:-1], step=0.001)
    record = record_of(inputs, states[:, :1] + 1e-3 * np.random.default_rng(0).normal(size=(4000, 1)), 0.001)
    experiment = resample(record, Sampling(step=0.001, period=0.02)).experiment(system)
    fitted = fitting.fit(system, [experiment], again=True)
    assert fitted.covariance[0, 0] > 0.0
    assert fitted.covariance[fitted.names.index("useless"), fitted.names.index("useless")] == 0.0


def test_blocks_apart_spread_as_their_own_means():
    """Of a mean: two records in two blocks each, whose errors have levels of their own."""
    levels = np.repeat([0.3, -0.1, 0.4, 0.1], 50)
    found = block_spread(np.ones((200, 1)), levels, np.array([0, 100, 200]))
    assert found[0] == pytest.approx(np.std([0.3, -0.1, 0.4, 0.1], ddof=1) / 2)
    level_and_gain = np.column_stack([np.ones(200), np.repeat([1.0, 2.0, 3.0, 4.0], 50)])  # which no block tells apart
    assert np.isinf(block_spread(level_and_gain, levels, np.array([0, 100, 200]))).all()


def test_a_short_piece_of_a_record_says_little_of_the_spread_and_of_the_errors_colour():
    """A slope by white regressors in coloured errors: 20 rows beside 4000, and without them."""
    random = np.random.default_rng(3)
    regressor, errors = np.repeat(random.normal(size=(402, 1)), 10, axis=0), np.zeros(4020)
    for k in range(1, 4020):
        errors[k] = 0.95 * errors[k - 1] + random.normal()
    regressor[:20] *= 1e-3  # which moves little there
    both, alone = np.array([0, 20, 4020]), np.array([0, 4000])
    assert block_spread(regressor, errors, both)[0] < 3.0 * block_spread(regressor[20:], errors[20:], alone)[0]
    found, without = (
        covariances(jacobian, residuals, edges)[1][0, 0]
        for jacobian, residuals, edges in ((regressor, errors, both), (regressor[20:], errors[20:], alone))
    )
    assert found == pytest.approx(without, rel=0.1)


def test_searches_from_both_sides_end_at_the_best_and_count_the_others():
    """Of r = (x - 1 - j, x + 1 - j) with a jump j = .45 sign(x - .1) each side of the jump has an end at x = j."""
    slope = np.full((2, 1), 1.0)

    def residuals(x):
        return x[0] - 0.45 * np.sign(x[0] - 0.1) + np.array([-1.0, 1.0])

    problem: Any = SimpleNamespace(
        system=SimpleNamespace(weights=()),
        bounds=(np.array([-9.0]), np.array([9.0])),
        residuals=lambda horizon: residuals,
        jacobian=lambda horizon, run: lambda x: slope,
        edges=lambda horizon: np.array([0, 2]),
    )
    limits = 1e-9, 40
    for begin, end in ((-2.0, -0.45), (2.0, 0.45)):
        solution = fitting._solve(problem, None, np.array([begin]), limits, map)
        assert solution.x[0] == pytest.approx(end)
        best, spread = fitting._searched_again(problem, None, solution, limits, map)
        assert abs(best.x[0]) == pytest.approx(0.45)
        assert np.sqrt(spread[0, 0]) == pytest.approx(0.9 / np.sqrt(2.0))
