"""Accuracy from simulated and live shots, against Bayes' rule itself, textbook tests and Monte Carlo."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from hybrid_sysid_ros.extensions.accuracy.statistics import (
    Discrepancy,
    NormalInverseWishart,
    Shots,
    Strata,
    assess,
    assumptions,
    conflict,
    mean_width,
    shots_until,
    spread_width,
)
from hybrid_sysid_ros.extensions.accuracy.statistics.assumptions import outlying
from hybrid_sysid_ros.extensions.accuracy.statistics.circular_error import circular_error_probable
from hybrid_sysid_ros.support.errors import UserError

COVARIANCE = np.array([[1.0, 0.3], [0.3, 1.0]])
NOTHING = NormalInverseWishart.reference(2)
REPETITIONS = 4000
BOUND = 0.02
"""Four standard deviations of a share of .9 in so many repetitions."""


def shots(generator: np.random.Generator, *shape: int) -> np.ndarray:
    return generator.standard_normal((*shape, 2)) @ np.linalg.cholesky(COVARIANCE).T


def log_density(known: NormalInverseWishart, mean: np.ndarray, covariance: np.ndarray) -> float:
    """By scipy's distributions."""
    of_mean = stats.multivariate_normal(known.centre, covariance / known.strength).logpdf(mean)
    return float(of_mean + stats.invwishart(known.degrees, known.scale).logpdf(covariance))


def test_the_posterior_is_prior_times_likelihood():
    """Log posterior less log prior less log likelihood is one constant, wherever it is asked."""
    generator = np.random.default_rng(0)
    prior = NormalInverseWishart(centre=np.array([0.4, -1.0]), strength=2.5, scale=3 * COVARIANCE, degrees=7.3)
    live = shots(generator, 6)
    posterior = prior.updated(live)
    constants = []
    for _ in range(5):
        mean, covariance = generator.standard_normal(2), stats.invwishart(6, COVARIANCE).rvs(random_state=generator)
        likelihood = stats.multivariate_normal(mean, covariance).logpdf(live).sum()
        constants.append(log_density(posterior, mean, covariance) - log_density(prior, mean, covariance) - likelihood)
    assert np.ptp(constants) < 1e-9


def test_shots_tell_the_same_at_once_and_one_after_the_other():
    live = shots(np.random.default_rng(1), 9)
    parts, whole = NOTHING.updated(live[:4]).updated(live[4:5]).updated(live[5:]), NOTHING.updated(live)
    assert parts.scale == pytest.approx(whole.scale)
    assert parts.centre == pytest.approx(whole.centre)
    assert (parts.strength, parts.degrees) == (whole.strength, whole.degrees)


def test_one_coordinate_without_a_prior_has_the_intervals_of_the_textbook():
    """Student's t for the mean, chi2 with n - 1 degrees of freedom for the standard deviation."""
    live = np.random.default_rng(2).normal(3.0, 2.0, 12)
    posterior = NormalInverseWishart.reference(1).updated(live[:, None])
    classic = stats.ttest_1samp(live, 0.0).confidence_interval(0.9)
    assert np.concatenate(posterior.mean_interval(0.9)) == pytest.approx([classic.low, classic.high])
    squares = float(np.sum((live - live.mean()) ** 2))
    assert np.concatenate(posterior.spread_interval(0.9)) == pytest.approx(
        np.sqrt(squares / stats.chi2.ppf([0.95, 0.05], 11))
    )


def test_two_coordinates_without_a_prior_have_hotelling_s_region():
    """T2 (n - d) / (d (n - 1)) ~ F(d, n - d)."""
    live = shots(np.random.default_rng(3), 8)
    offset = live.mean(axis=0)
    hotelling = 8 * offset @ np.linalg.inv(np.cov(live.T)) @ offset
    assert NOTHING.updated(live).mean_distance(np.zeros(2)) == pytest.approx(stats.f.cdf(hotelling * 6 / 14, 2, 6))


def test_marginal_intervals_are_those_of_draws():
    """Mean and standard deviation drawn by scipy's inverse Wishart; 3 % is five standard errors of such a quantile."""
    known = NormalInverseWishart(centre=np.array([1.0, 2.0]), strength=3.0, scale=8 * COVARIANCE, degrees=9.5)
    generator, count = np.random.default_rng(4), 40_000
    covariances = stats.invwishart(9.5, 8 * COVARIANCE).rvs(count, random_state=generator)
    roots = np.linalg.cholesky(covariances / 3.0)
    means = known.centre + (roots @ generator.standard_normal((count, 2, 1)))[..., 0]
    spreads = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    for drawn, interval in ((means, known.mean_interval(0.9)), (spreads, known.spread_interval(0.9))):
        assert np.quantile(drawn, [0.05, 0.95], axis=0) == pytest.approx(np.array(interval), abs=0.03)
    assert stats.kstest(known.mean_distance(means), "uniform").pvalue > 1e-3
    own = known.covariances(count, generator)
    for k, j in ((0, 0), (0, 1), (1, 1)):
        assert stats.ks_2samp(own[:, k, j], covariances[:, k, j]).pvalue > 1e-3


def test_a_declared_discrepancy_is_what_the_prior_then_holds():
    """Of very many simulated shots: the logarithm of the spread varies by tau_s, the mean by tau_b sigma."""
    generator = np.random.default_rng(5)
    known = NOTHING.updated(shots(generator, 100_000))
    prior = Discrepancy(mean=0.7, spread=0.1).weaken(known)
    covariances = stats.invwishart(prior.degrees, prior.scale).rvs(20_000, random_state=generator)
    assert np.std(0.5 * np.log(covariances[:, 0, 0])) == pytest.approx(0.1, rel=0.05)
    assert np.median(np.sqrt(covariances[:, 0, 0])) == pytest.approx(1.0, abs=0.02)
    assert prior.strength**-0.5 == pytest.approx(0.7, rel=1e-4)
    same = Discrepancy(mean=0.0, spread=0.0).weaken(known)
    assert (same.strength, same.marginal_degrees) == pytest.approx((known.strength, known.degrees))
    assert Discrepancy(mean=math.inf, spread=0.1).weaken(known).strength == 0.0


@pytest.mark.parametrize("given", [{"mean": -0.1, "spread": 0.1}, {"mean": 0.5, "spread": math.inf},
                                   {"mean": 0.5, "spread": 0.4}, {"mean": math.nan, "spread": 0.1}])  # fmt: skip
def test_a_discrepancy_that_is_none_is_refused(given):
    with pytest.raises(UserError, match="discrepancy of the"):
        Discrepancy(**given)


@pytest.mark.parametrize("count", [5, 20])
def test_intervals_hold_the_truth_as_often_as_they_say(count):
    """Live shots alone; a simulation that is exact; one that is off as it was declared."""
    generator, declared = np.random.default_rng(count), Discrepancy(mean=0.5, spread=0.1)
    simulated = NOTHING.updated(shots(generator, REPETITIONS, 200))
    factor = np.exp(0.1 * generator.standard_normal((REPETITIONS, 2)))
    offset = factor * 0.5 * shots(generator, REPETITIONS)
    exact, zero, one = shots(generator, REPETITIONS, count), np.zeros(2), np.ones(2)
    drawn = offset[:, None, :] + factor[:, None, :] * shots(generator, REPETITIONS, count)
    for posterior, mean, spread in (
        (NOTHING.updated(exact), zero, one),
        (simulated.updated(exact), zero, one),
        (declared.weaken(simulated).updated(drawn), offset, factor),
    ):
        low, high = posterior.spread_interval(0.9)
        assert np.mean(posterior.mean_distance(mean) <= 0.9) == pytest.approx(0.9, abs=BOUND)
        assert np.mean((low <= spread) & (spread <= high)) == pytest.approx(0.9, abs=BOUND)


@pytest.mark.parametrize("coordinates", [1, 2, 3, 4])
def test_the_level_of_each_coordinate_s_intervals_holds_whatever_others_there_are(coordinates):
    """Five live shots of a simulation that may be off by half a deviation and by a third of the spread."""
    generator, declared = np.random.default_rng(coordinates), Discrepancy(mean=0.5, spread=0.3)
    root = np.linalg.cholesky(0.3 + 0.7 * np.eye(coordinates))

    def fired(count: int) -> np.ndarray:
        return generator.standard_normal((REPETITIONS, count, coordinates)) @ root.T

    simulated = NormalInverseWishart.reference(coordinates).updated(fired(200))
    factor = np.exp(0.3 * generator.standard_normal((REPETITIONS, coordinates)))
    offset = factor * 0.5 * fired(1)[:, 0]
    live = offset[:, None, :] + factor[:, None, :] * fired(5)
    posterior = declared.weaken(simulated).updated(live)
    for (low, high), true in ((posterior.mean_interval(0.9), offset), (posterior.spread_interval(0.9), factor)):
        assert np.mean((low <= true) & (true <= high)) == pytest.approx(0.9, abs=BOUND)
    alone = NormalInverseWishart.reference(coordinates).updated(live).of_each_alone
    (low, high), free = alone.mean_interval(0.9), live.shape[1] - 1
    half = stats.t.ppf(0.95, free) * live.std(axis=1, ddof=1) / np.sqrt(live.shape[1])
    assert 0.5 * (high - low) == pytest.approx(half)


def test_one_outlier_of_one_coordinate_is_student_s_deleted_residual():
    """Wilks's test is then that of the outermost shot against the others: here at a p-value about the level."""
    values = np.random.default_rng(16).normal(size=(12, 1))
    for far, outlier in ((4.6, False), (5.4, True)):
        values[3] = np.delete(values, 3).mean() + far * np.delete(values, 3).std(ddof=1)
        p = 12 * 2 * stats.t.sf(far / np.sqrt(1 + 1 / 11), 10)
        assert (p < 0.01) == outlier
        assert outlying(values) == ([3] if outlier else [])


def test_outliers_do_not_hide_each_other_and_normal_shots_are_none():
    generator = np.random.default_rng(17)
    found = [outlying(shots(generator, 12)) for _ in range(300)]
    assert sum(map(bool, found)) <= 9  # 1 % of them, and some
    hidden = shots(generator, 16)
    hidden[[2, 9]] += [0.0, 30.0]
    assert outlying(hidden) == [2, 9]


def test_shots_that_are_not_independent_or_normal_are_doubted():
    generator = np.random.default_rng(18)
    fine, drifting, skewed = (shots(generator, 30) for _ in range(3))
    drifting[:, 1] += np.linspace(-3.0, 3.0, 30)
    skewed[:, 0] = np.exp(skewed[:, 0])
    assert not assumptions(of(fine), generator).sentences
    (sentence,) = assumptions(of(drifting, "live.csv"), generator).sentences
    assert sentence.startswith("live.csv: shots depend on those before them (y by a rank correlation of 0.")
    assert any("x is not normal" in sentence for sentence in assumptions(of(skewed), generator).sentences)


def test_without_a_discrepancy_the_means_are_compared_as_by_student_and_hotelling():
    generator, exact = np.random.default_rng(6), Discrepancy(mean=0.0, spread=0.0)
    one, two = generator.normal(0.0, 1.0, 30), generator.normal(0.6, 1.0, 9)
    prior = exact.weaken(NormalInverseWishart.reference(1).updated(one[:, None]))
    found = conflict(prior, two[:, None], generator, simulated=one.std(ddof=1)[None])
    assert found.mean == pytest.approx(stats.ttest_ind(one, two).pvalue)
    one, two = shots(generator, 30), shots(generator, 9) + 0.5
    offset = two.mean(axis=0) - one.mean(axis=0)
    pooled = (29 * np.cov(one.T) + 8 * np.cov(two.T)) / 37
    hotelling = 30 * 9 / 39 * offset @ np.linalg.inv(pooled) @ offset
    found = conflict(exact.weaken(NOTHING.updated(one)), two, generator, simulated=one.std(axis=0, ddof=1))
    assert found.mean == pytest.approx(stats.f.sf(hotelling * 36 / 74, 2, 36))
    assert found.offset == pytest.approx(offset / one.std(axis=0, ddof=1))
    assert found.ratio == pytest.approx(two.std(axis=0, ddof=1) / one.std(axis=0, ddof=1))


def test_without_a_discrepancy_the_spreads_are_compared_as_by_bartlett_and_box():
    """Their chi2 approximations, close for so many shots; a drawn p-value is known to .01."""
    generator, exact = np.random.default_rng(7), Discrepancy(mean=0.0, spread=0.0)
    one, two = generator.normal(0.0, 1.0, 60), generator.normal(0.0, 1.2, 50)
    prior = exact.weaken(NormalInverseWishart.reference(1).updated(one[:, None]))
    found = conflict(prior, two[:, None], generator, simulated=one.std(ddof=1)[None])
    assert found.spread == pytest.approx(stats.bartlett(one, two).pvalue, abs=0.015)
    one, two = shots(generator, 60), 1.15 * shots(generator, 50)
    matrices, free = [np.cov(one.T), np.cov(two.T)], np.array([59.0, 49.0])
    pooled = sum(f * matrix for f, matrix in zip(free, matrices, strict=True)) / free.sum()
    box = free.sum() * np.log(np.linalg.det(pooled)) - free @ np.log(np.linalg.det(matrices))
    box *= 1 - (np.sum(1 / free) - 1 / free.sum()) * 13 / 18  # (2 d^2 + 3 d - 1) / (6 (d + 1)), d = 2
    found = conflict(exact.weaken(NOTHING.updated(one)), two, generator, simulated=one.std(axis=0, ddof=1))
    assert found.spread == pytest.approx(stats.chi2.sf(box, 3), abs=0.015)


def test_a_simulation_that_is_not_believed_is_not_contradicted():
    generator = np.random.default_rng(8)
    known = NOTHING.updated(shots(generator, 50))
    assert math.isnan(
        conflict(
            Discrepancy(mean=math.inf, spread=0.1).weaken(known), shots(generator, 5), generator, simulated=np.ones(2)
        ).mean
    )


def test_circular_error_probable_at_its_limits():
    """A circle: sqrt(2 ln 2); a line: the probable error, .6745."""
    assert circular_error_probable(4.0 * np.eye(2)) == pytest.approx(2.0 * math.sqrt(2.0 * math.log(2.0)), rel=1e-6)
    assert circular_error_probable(np.diag([0.0, 9.0])) == pytest.approx(3.0 * stats.norm.ppf(0.75), rel=1e-6)


@pytest.mark.parametrize(
    "covariance", [[[1.0, 0.3], [0.3, 1.0]], [[4.0, -0.9], [-0.9, 0.3]], [[1.0, 0.0], [0.0, 0.01]]]
)
def test_half_of_the_shots_are_within_the_circular_error_probable(covariance):
    drawn = stats.multivariate_normal(np.zeros(2), covariance).rvs(400_000, random_state=9)
    within = np.mean(np.hypot(*drawn.T) <= circular_error_probable(np.array(covariance)))
    assert within == pytest.approx(0.5, abs=0.0032)  # four standard deviations


@pytest.mark.parametrize("width", [mean_width, spread_width])
def test_widths_after_more_shots_are_predicted(width):
    """The .9 quantile of the widths that follow from shots drawn with the posterior's mean and covariance."""
    generator = np.random.default_rng(10)
    posterior = (
        Discrepancy(mean=0.5, spread=0.1).weaken(NOTHING.updated(shots(generator, 200))).updated(shots(generator, 6))
    )
    covariances = posterior.covariances(REPETITIONS, generator)
    means = posterior.centre + np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariances / posterior.strength), generator.standard_normal((REPETITIONS, 2))
    )
    noise = generator.standard_normal((REPETITIONS, 15, 2)) @ np.swapaxes(np.linalg.cholesky(covariances), 1, 2)
    later = posterior.updated(means[:, None, :] + noise)
    low, high = (later.mean_interval if width is mean_width else later.spread_interval)(0.9)
    expected = np.quantile((high - low)[:, 1], 0.9)
    assert width(posterior, 1, 15, 0.9, 0.9) == pytest.approx(expected, rel=0.01)
    low, high = (posterior.mean_interval if width is mean_width else posterior.spread_interval)(0.9)
    assert width(posterior, 1, 0, 0.9, 0.9) == pytest.approx((high - low)[1])


def test_shots_until_an_interval_is_short_enough():
    posterior = NOTHING.updated(shots(np.random.default_rng(11), 8))
    more = shots_until(mean_width, posterior, 0, 0.4, 0.9)
    assert mean_width(posterior, 0, more, 0.9, 0.9) <= 0.4 < mean_width(posterior, 0, more - 1, 0.9, 0.9)
    assert shots_until(mean_width, posterior, 0, 100.0, 0.9) == 0
    with pytest.raises(UserError, match="more than 1000000 further shots"):
        shots_until(mean_width, posterior, 0, 1e-9, 0.9)


def test_stratified_shots_save_what_the_efficiency_says():
    """Variance of the estimate without strata over that with them, by simulation; 1.376 in the facts' example."""
    strata = Strata(shares=np.array([0.3, 0.5, 0.2]), successes=np.array([0.2, 0.6, 0.9]))
    assert strata.efficiency == pytest.approx(1.376, abs=5e-4)
    assert strata.saved == pytest.approx(0.273, abs=5e-4)
    counts = strata.allocation(100)
    assert counts.tolist() == [28, 58, 14]
    assert strata.allocation(4).tolist() == [1, 2, 1]
    generator = np.random.default_rng(12)
    hits = generator.binomial(counts, strata.successes, (100_000, 3)) / counts
    plain = generator.binomial(100, 0.54, 100_000) / 100
    assert np.var(plain) / np.var(hits @ strata.shares) == pytest.approx(strata.efficiency, rel=0.03)


@pytest.mark.parametrize(
    ("shares", "successes", "reported"),
    [([0.3, 0.5], [0.2, 0.6], "1 together"), ([0.5, 0.5], [0.2, 1.0], "between 0 and 1")],
)
def test_strata_that_are_none_are_refused(shares, successes, reported):
    with pytest.raises(UserError, match=reported):
        Strata(shares=np.array(shares), successes=np.array(successes))


def of(values: np.ndarray, name: str = "shots", units: tuple[str, ...] = ()) -> Shots:
    names = tuple("xyzw"[: values.shape[1]])
    return Shots(name=name, names=names, units=units or ("m",) * len(names), values=values)


def test_three_coordinates_have_all_but_a_circular_error():
    generator = np.random.default_rng(13)
    drawn = generator.standard_normal((60, 3)), generator.standard_normal((10, 3))
    found = assess(of(drawn[0]), of(drawn[1]), Discrepancy(mean=0.5, spread=0.1))
    assert set(found.joint.correlation) == {(0, 1), (0, 2), (1, 2)}
    assert found.joint.circular_error is None


def test_one_coordinate_is_enough():
    generator = np.random.default_rng(14)
    drawn = generator.standard_normal((60, 1)), generator.standard_normal((3, 1))
    found = assess(of(drawn[0]), of(drawn[1]), Discrepancy(mean=0.5, spread=0.1))
    assert found.joint.mean[0].width < found.live_only.mean[0].width
    assert not found.joint.correlation


def test_another_unit_changes_the_numbers_and_nothing_else():
    """Ten times the numbers: ten times every interval, the same correlation and conflict."""
    generator = np.random.default_rng(15)
    simulated, live = shots(generator, 100), shots(generator, 6)
    one, ten = (
        assess(of(factor * simulated), of(factor * live), Discrepancy(mean=0.5, spread=0.1)) for factor in (1.0, 10.0)
    )
    assert ten.joint.mean[1].low == pytest.approx(10 * one.joint.mean[1].low)
    assert ten.joint.circular_error
    assert one.joint.circular_error
    assert ten.joint.circular_error.high == pytest.approx(10 * one.joint.circular_error.high)
    assert ten.joint.correlation[0, 1].low == pytest.approx(one.joint.correlation[0, 1].low)
    assert (ten.conflict.mean, ten.conflict.spread) == pytest.approx((one.conflict.mean, one.conflict.spread))
