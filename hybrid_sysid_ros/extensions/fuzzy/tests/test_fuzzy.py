"""Fuzzy models: clusters, rules and links against closed forms, a known plant, and textbook recursive least squares."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.fuzzy.data import DRIVE, LEVEL, RIG, free_run_error, mackey_glass, sines, training
from hybrid_sysid_ros.core import Variable, simulate
from hybrid_sysid_ros.estimation import estimator_class
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.extensions.fuzzy.clustering import fuzzy_c_means, gustafson_kessel, k_means
from hybrid_sysid_ros.extensions.fuzzy.difnn import Difnn
from hybrid_sysid_ros.extensions.fuzzy.link_selection import select_links
from hybrid_sysid_ros.extensions.fuzzy.memberships import memberships
from hybrid_sysid_ros.extensions.fuzzy.rule_selection import select_rules
from hybrid_sysid_ros.extensions.fuzzy.takagi_sugeno import TakagiSugeno
from hybrid_sysid_ros.extensions.fuzzy.tuning import tuned
from hybrid_sysid_ros.identification import PreparedRecord
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError

SIGNALS: dict[str, Any] = {"outputs": [LEVEL], "inputs": [DRIVE], "output_lags": 1, "input_lags": 1}


@pytest.fixture(scope="module")
def plant():
    return load(RIG).system


@pytest.fixture(scope="module")
def record(plant):
    return training(plant, 0)


def short(rows):
    """The first rows of a record."""
    inputs, outputs = np.random.default_rng(0).uniform(-1, 1, (rows, 1)), np.zeros((rows + 1, 1))
    outputs[1:] = inputs
    return PreparedRecord(
        name="short", sampling=Sampling(step=0.05, period=0.05), inputs=inputs, outputs=outputs, states=outputs
    )


# Clusters


def test_two_points_are_their_own_centres():
    np.testing.assert_allclose(
        np.sort(fuzzy_c_means(np.repeat([[0.0, 1.0], [4.0, -2.0]], 20, axis=0), 2), axis=0),
        [[0.0, -2.0], [4.0, 1.0]], atol=1e-4,
    )  # fmt: skip


def test_centres_of_fuzzy_c_means_are_the_means_of_their_members():
    """The necessary condition of Bezdek (1981), (11.3b): c_i = sum_t h_ti^2 z_t / sum_t h_ti^2."""
    points = np.random.default_rng(0).normal(size=(300, 2))
    centres = fuzzy_c_means(points, 4)
    parts = memberships(points, centres, np.ones_like(centres)) ** 2
    np.testing.assert_allclose(parts.T @ points / parts.sum(axis=0)[:, None], centres, atol=1e-5)


def test_ellipsoids_find_what_balls_do_not():
    """Two clusters as long as they are apart, side by side: widths along them are larger than across."""
    random = np.random.default_rng(0)
    points = random.normal(size=(400, 2)) * [3.0, 0.1]
    points[200:, 1] += 2.0
    centres, widths = gustafson_kessel(points, 2)
    np.testing.assert_allclose(np.sort(centres[:, 1]), [0.0, 2.0], atol=0.05)
    np.testing.assert_allclose(np.prod(widths, axis=1), 1.0)
    assert np.all(widths[:, 0] > 10.0 * widths[:, 1])


def test_k_means_finds_equal_parts_of_a_line():
    """Of values that are everywhere alike the best centres are in the middle of equal parts."""
    values = np.linspace(0.0, 1.0, 1001)
    np.testing.assert_allclose(k_means(values, 4), [0.125, 0.375, 0.625, 0.875], atol=0.02)


# Rules


def test_three_rules_are_the_plant_itself(plant, record):
    """Memberships of inverse squares are rational functions as y / (1 + y^2) is: tuned rules leave next to nothing, by
    the level alone, which validation chooses since the drive acts linearly.
    """
    chosen = select_rules([record], rules=3, **SIGNALS)
    assert chosen.premises == (0,)
    system = tuned(chosen, [record]).system
    assert free_run_error(plant, system) < 1e-4


def test_one_rule_is_linear_regression(record):
    """Against numpy's least squares."""
    system = select_rules([record], rules=1, premises=(0,), **SIGNALS)
    rows = np.column_stack([np.ones(1000), record.outputs[:-1], record.inputs])
    expected = np.linalg.lstsq(rows, record.outputs[1:, 0], rcond=None)[0]
    scales = np.array([1.0, system.scales[0], system.scales[1]])
    np.testing.assert_allclose(system.consequents, expected * scales / system.scales[0], atol=1e-6)


def test_rules_that_made_the_data_are_found_again():
    """A model of two rules, taught by its own free run, from clusters elsewhere."""
    truth = TakagiSugeno(
        outputs=(LEVEL,), inputs=(DRIVE,), output_lags=1, input_lags=1, scales=(1.0, 1.0), low=(-9.0, -9.0),
        high=(9.0, 9.0), premises=(0,), rules=2, premise_weights=(-0.5, 0.1, 0.8, -0.2), period=0.05,
        consequents=(0.3, 0.5, 1.0, -0.2, -0.4, 0.6),
    )  # fmt: skip
    inputs = np.random.default_rng(1).uniform(-1, 1, (500, 1))
    outputs = simulate(truth, np.zeros(1), inputs, step=0.05)
    item = PreparedRecord(
        name="own", sampling=Sampling(step=0.05, period=0.05), inputs=inputs, outputs=outputs, states=outputs
    )
    found = tuned(select_rules([item], rules=2, premises=(0,), **SIGNALS), [item]).system
    np.testing.assert_allclose(simulate(found, np.zeros(1), inputs, step=0.05), outputs, atol=1e-4)


def test_growth_ends_where_a_line_is_enough():
    """y+ = .5 y + u with noise: more rules than one lower nothing."""
    random = np.random.default_rng(0)
    inputs = random.uniform(-1, 1, (600, 1))
    y = np.zeros((601, 1))
    for k in range(600):
        y[k + 1] = 0.5 * y[k] + inputs[k] + 0.1 * random.normal()
    item = PreparedRecord(name="line", sampling=Sampling(step=0.05, period=0.05), inputs=inputs, outputs=y, states=y)
    assert select_rules([item], **SIGNALS).rules == 1


def test_rules_are_reported_in_words_and_units():
    system = TakagiSugeno(
        outputs=(Variable(name="level", unit="m"),), inputs=(Variable(name="valve", unit="V"),), output_lags=1,
        input_lags=1, scales=(2.0, 4.0), low=(-2.0, -8.0), high=(2.0, 8.0), premises=(0,), rules=1,
        premise_weights=(0.5, 0.0), consequents=(0.25, 0.5, -1.0),
    )  # fmt: skip
    assert system.words == ("if level is about 1 m (width 2), then level becomes 0.5 + 0.5 level - 0.5 valve",)


def test_memberships_are_drawn_along_each_premise():
    """At its centre a rule has all of the membership."""
    pytest.importorskip("plotly")
    from hybrid_sysid_ros.extensions.fuzzy.report import figures

    system = TakagiSugeno(
        outputs=(LEVEL,), inputs=(DRIVE,), output_lags=1, input_lags=1, scales=(1.0, 2.0), low=(-1.0, -2.0),
        high=(1.0, 2.0), premises=(0, 1), rules=2, premise_weights=(-0.5, 0.25, 0.0, 0.0, 0.5, -0.25, 0.0, 0.0),
    )  # fmt: skip
    curves = figures.membership_figure(system).data
    peaks = [float(curve.x[np.argmax(curve.y)]) for curve in curves]
    np.testing.assert_allclose(peaks, [-0.5, 0.5, 0.5, -0.5])
    assert [max(curve.y) for curve in curves] == pytest.approx([1.0] * 4)


@pytest.mark.parametrize("kind", [TakagiSugeno, Difnn])
def test_a_design_survives_a_file(record, kind):
    system = select_rules([record], rules=3, **SIGNALS) if kind is TakagiSugeno else _linked(record)
    again = kind.of(yaml.safe_load(yaml.safe_dump(system.design)), system.weights).with_values(system.values)
    assert again == system


# Consequents online


def test_consequents_that_are_followed_are_those_of_recursive_least_squares(record):
    """The filter on exact readings against the textbook recursion: Ljung (1999), (11.16) as a Kalman filter."""
    drift, noise, steps = 0.02, 0.05, 40
    given = select_rules([record], rules=2, premises=(0,), **SIGNALS)
    given = replace(given, low=(-50.0, -50.0), high=(50.0, 50.0))  # the filter tries values beyond the record's band
    names = [item.name for item in given.parameters if item.learned]
    tuning = Tuning(
        measurement_noise=(1e-7,), process_noise=(noise / np.sqrt(0.05),), disturbance_noise=(0.0,),
        disturbance_limit=(0.0,), gate=1e9, followed=dict.fromkeys(names, drift),
    )  # fmt: skip
    moved = given.with_values([v + 0.1 * bool(p.learned) for p, v in zip(given.parameters, given.values, strict=True)])
    truth = simulate(moved, record.outputs[0], record.inputs[:steps], step=0.05)
    estimator = estimator_class("ekf")(given, tuning, period=0.05, latency=0.0)
    estimate = estimator.update(0.0, truth[0], np.zeros(1))
    theta, cov = estimate.parameters.copy(), estimate.covariance[-len(names) :, -len(names) :].copy()
    centres, widths = given.centres / given.scales[0], given.widths / given.scales[0]
    for k in range(steps):
        estimate = estimator.update(0.05 * (k + 1), truth[k + 1], record.inputs[k])
        r = np.array([truth[k, 0], record.inputs[k, 0]]) / given.scales
        row = np.outer(memberships(r[:1][None], centres, widths)[0], [1.0, *r]).ravel() * given.scales[0]
        variance = row @ cov @ row + noise**2
        gain = cov @ row / variance
        theta = theta + gain * (truth[k + 1, 0] - row @ theta)
        cov = cov - np.outer(gain, row @ cov) + 0.05 * drift**2 * np.eye(len(names))
        np.testing.assert_allclose(estimate.parameters, theta, atol=1e-6)


# DIFNN


def _linked(record):
    return select_links([record], terms=5, **SIGNALS)


def test_links_are_counted_winners():
    """y+ = u: the terms of u and of y+ are the same, so each rule is linked to its own term and to no other."""
    item = short(400)
    system = select_links([item], terms=4, outputs=[LEVEL], inputs=[DRIVE], output_lags=0, input_lags=1)
    assert system.antecedents == ((0,), (1,), (2,), (3,))
    assert system.links == (((0, 0), (1, 1), (2, 2), (3, 3)),)


def test_rules_of_several_inputs_are_those_that_data_show(record):
    """Of five terms of level and drive each, fewer than all 25 pairs are rules when they never meet."""
    system = _linked(record)
    assert {len(rule) for rule in system.antecedents} == {2}
    some = select_links([record], terms=5, least=30, **SIGNALS)
    assert 0 < len(some.antecedents) < len(system.antecedents) <= 25


def test_rules_share_terms_of_the_output():
    """An even function has the same value at two places: less terms than rules, each rule leads to one."""
    points = np.linspace(-1.0, 1.0, 101)[:, None]
    item = replace(short(101), inputs=points, outputs=np.concatenate([[[1.0]], np.cos(np.pi * points)]))
    links = select_links([item], terms=9, outputs=[LEVEL], inputs=[DRIVE], output_lags=0, input_lags=1).links[0]
    assert [rule for rule, _ in links] == [*range(9)]
    assert [term for _, term in links] == [term for _, term in reversed(links)]


def test_a_function_of_one_input_is_tuned_to_a_hundred_thousandth():
    """In the hundred steps of a stage, by 15 rules."""
    points = np.linspace(-1.0, 1.0, 201)[:, None]
    values = sines(points)
    item = replace(short(201), inputs=points, outputs=np.concatenate([values[:1], values]))
    system = select_links([item], terms=15, outputs=[LEVEL], inputs=[DRIVE], output_lags=0, input_lags=1)
    found = simulate(tuned(system, [item]).system, np.zeros(1), points, step=item.sampling.step)[1:]
    assert np.sqrt(np.mean((found - values) ** 2)) < 1e-5


def test_a_tuned_network_learns_the_plant(plant, record):
    """From a tenth of the deviation to a hundredth."""
    initial = _linked(record)
    fitted = tuned(initial, [record]).system
    assert free_run_error(plant, fitted) < 0.05 < 0.3 * free_run_error(plant, initial) + 0.05


# Bad input


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rules": 200}, "take 33 rules or fewer"),
        ({"rules": 3, "premises": (0,), "ellipsoids": True}, "3 of them for 1 different points"),
        ({"rules": 2, "premises": (0,)}, "2 of them for 1 different points"),
    ],
)
def test_rules_that_data_do_not_carry_are_refused(change, words):
    item = replace(short(100), outputs=np.zeros((101, 1)))
    with pytest.raises(UserError, match=words):
        select_rules([item], **SIGNALS, **change)


def test_singular_clusters_are_refused_with_the_cure():
    line = np.repeat(np.linspace(-1.0, 1.0, 50)[:, None], 2, axis=1)
    with pytest.raises(UserError, match=r"singular.*fuzzy C-means"):
        gustafson_kessel(line, 2)


def test_terms_without_data_are_refused():
    still = replace(short(100), inputs=np.zeros((100, 1)))
    with pytest.raises(UserError, match="4 terms of a variable of 1 different values; take 1"):
        select_links([still], terms=4, **SIGNALS)
    with pytest.raises(UserError, match="no rule has 500 samples"):
        select_links([short(100)], terms=4, least=500, **SIGNALS)


def test_weights_that_do_not_fit_are_refused(record):
    system = select_rules([record], rules=2, **SIGNALS)
    with pytest.raises(UserError, match="fit again"):
        replace(system, premise_weights=(1.0,))
    with pytest.raises(UserError, match="consequents"):
        replace(system, consequents=(1.0,))
    with pytest.raises(UserError, match="premises"):
        replace(system, premises=(7,))
    with pytest.raises(UserError, match="fit again"):
        replace(_linked(record), links=(((0, 9),),))


# The benchmark's data


def test_the_series_of_mackey_and_glass_has_the_published_spread():
    """Its deviation over the thousand samples that are usually taken is .226."""
    x = mackey_glass(1200)
    assert x[0] == 1.2
    assert x[118:1118].std() == pytest.approx(0.226, abs=1e-3)
