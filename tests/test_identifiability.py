"""Identifiability: what a covariance says about the parameters, against regressions known by heart."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.identification.validation.identifiability import at_bound, correlated, correlation, doubts
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs import rig as rigs

EQUATION = rigs.load("cam_beam").system
FREE = [item for item in EQUATION.parameters if not item.fixed]


def before(item):
    """Standard deviation of the prior, or of anything between the bounds."""
    return item.spread or (item.high - item.low) / np.sqrt(12)


def model(errors=None, correlations=None, values=None):
    """A model whose standard errors are a hundredth of what was known before, but for those given."""
    names = [item.name for item in FREE]
    deviations = np.array([(errors or {}).get(item.name, 0.01 * before(item)) for item in FREE])
    coefficients = np.eye(len(names))
    for (first, second), value in (correlations or {}).items():
        i, j = names.index(first), names.index(second)
        coefficients[i, j] = coefficients[j, i] = value
    middle = {item.name: 0.5 * (item.low + item.high) for item in FREE} | (values or {})
    return Model(
        rig="cam_beam",
        structure="gray",
        system=dataclasses.replace(EQUATION, **middle),
        sampling=Sampling(),
        names=tuple(names),
        covariance=coefficients * np.outer(deviations, deviations),
        training_range={},
    )


def test_a_line_has_the_correlation_of_its_offset_and_slope():
    # a + b t at t = 0 ... N - 1: cov ~ inv([[N, St], [St, Stt]]), rho = -St / sqrt(N Stt) = -sqrt(3 (N-1) / (4 N - 2))
    t = np.arange(50)
    regressors = np.column_stack([np.ones(50), t])
    covariance = 0.3 * np.linalg.inv(regressors.T @ regressors)
    rho = -np.sqrt(3 * 49 / (4 * 50 - 2))
    assert correlation(covariance)[0, 1] == pytest.approx(rho)
    ((first, second, value),) = correlated(["offset", "slope"], covariance, threshold=0.86)
    assert {first, second} == {"offset", "slope"}
    assert value == pytest.approx(rho)
    assert correlated(["offset", "slope"], covariance, threshold=0.87) == []


def test_what_the_data_determine_is_not_doubted():
    assert doubts(model()) == []


def test_two_that_move_together_are_named_for_each_other():
    wide = {name: 0.1 * before(item) for name in ("gain", "damping", "centre") for item in FREE if item.name == name}
    found = doubts(model(errors=wide, correlations={("gain", "damping"): 0.97, ("gain", "centre"): -0.96}))
    assert [doubt.parameter.name for doubt in found] == ["gain", "centre", "damping"]
    assert dict(found[0].correlated) == pytest.approx({"damping": 0.97, "centre": -0.96})
    assert "can't be told apart from damping (+0.97), centre (-0.96)" in str(found[0])


def test_two_that_move_together_are_no_doubt_where_both_are_known():
    fine = {"gain": 1e-3, "damping": 1e-3}
    assert (
        doubts(model(errors=fine, values={"gain": 5.0, "damping": 30.0}, correlations={("gain", "damping"): 0.99}))
        == []
    )


@pytest.mark.parametrize("name", ["gain", "creep"])  # one between bounds, one with a prior
def test_an_estimate_as_wide_as_before_is_doubted(name):
    item = next(item for item in FREE if item.name == name)
    assert doubts(model(errors={name: 0.49 * before(item)})) == []
    (doubt,) = doubts(model(errors={name: 0.6 * before(item)}))
    assert doubt.parameter.name == name
    assert str(doubt).startswith(f"{name} = ")
    assert f"(standard error {0.6 * before(item):.2g}) is hardly known better than before" in str(doubt)
    assert item.unit in str(doubt)


def test_what_moves_nothing_is_said_to():
    (doubt,) = doubts(model(errors={"input_delay": 0.0}))
    assert "(standard error unknown) has no effect on the output" in str(doubt)


def test_a_bound_is_doubted_whatever_the_error():
    (doubt,) = doubts(model(values={"coulomb": 0.0}))
    assert "stands at its lower bound 0" in str(doubt)
    (doubt,) = doubts(model(values={"asymmetry": 0.4999}))
    assert "stands at its upper bound 0.5" in str(doubt)


@pytest.mark.parametrize(
    ("value", "doubted"), [(0.01, True), (0.0105, True), (5.0, False), (500.0, False), (995.0, True)]
)
def test_a_bound_of_many_decades_is_near_by_magnitude(value: float, doubted: bool):
    frequency = dataclasses.replace(FREE[0], low=0.01, high=1000.0)
    assert at_bound(frequency, value) is doubted


@pytest.mark.parametrize(("error", "doubted"), [(6.8, False), (60.0, True), (float("inf"), True)])
def test_a_bound_that_is_far_by_the_standard_error_is_not_doubted(error: float, doubted: bool):
    wide = dataclasses.replace(FREE[0], low=-1e4, high=0.0)
    assert at_bound(wide, -19.9, error) is doubted


def test_weights_of_a_network_are_not_doubted():
    whole = model()
    covariance = np.zeros((len(FREE) + 2, len(FREE) + 2))
    covariance[:-2, :-2] = whole.covariance
    covariance[-2:, -2:] = [[1.0, 0.999], [0.999, 1.0]]
    assert doubts(dataclasses.replace(whole, names=(*whole.names, "weight_0", "weight_1"), covariance=covariance)) == []
