"""Bands of free runs, against closed forms."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm
from scipy.stats import t as student

from hybrid_sysid_ros.core import System, bounded, simulate
from hybrid_sysid_ros.identification import Part, identify, prepare
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.standard_errors import student_factor
from hybrid_sysid_ros.identification.validation.bands import (
    DRAWS,
    Uncertainty,
    _moved_by,
    _moved_by_others,
    bands_of,
    correlation_time,
    drawn_systems,
    freedom_of,
    widening_of,
)
from hybrid_sysid_ros.identification.validation.left_out import free_run_of, left_out
from hybrid_sysid_ros.models import Sampling
from tests.linear_bench import bench, held_levels, record_of

SAMPLING = Sampling(step=0.01, period=0.05, initial="first")


@dataclass(frozen=True, kw_only=True)
class Integrator(System):
    """x' = gain u."""

    states = ("level [m]",)
    inputs = ("flow [m/s]",)
    gain: float = bounded(2.0, 0.1, 10.0, unit="1")

    def law(self, x, u):
        return (self.gain * u[0],)


def level(noise=0.0):
    u = held_levels(0, 1001, hold=20)
    clean = np.concatenate([[0.0], np.cumsum(2.0 * 0.01 * u[:-1, 0])])
    return record_of(u, (clean + noise * np.random.default_rng(1).normal(size=1001))[:, None], 0.01)


def test_what_an_offset_and_a_parameter_leave_open_is_that_of_the_integral():
    """An offset b of the input: gain b t. A gain that is off by d: d / gain of the level itself."""
    record, covariance = level(), np.array([[0.01**2]])
    experiment = prepare(record, Integrator(), SAMPLING)
    known = Uncertainty(names=("gain",), covariance=covariance, spans=np.array([4.0]))
    first = np.zeros(1)
    run = free_run_of(Integrator(), experiment, first)
    time = 0.05 * np.arange(experiment.samples)
    moved = _moved_by(Integrator(), experiment, np.array([0.004]), first, run)
    np.testing.assert_allclose(np.sqrt(moved[:, 0]), 2.0 * 0.004 * time, atol=1e-9)
    random = np.random.default_rng(0)
    draw = np.sqrt(np.mean([(0.01 * random.normal()) ** 2 for _ in range(DRAWS // 2)]))
    drawn = _moved_by_others(drawn_systems(Integrator(), known), experiment, first, run)
    np.testing.assert_allclose(np.sqrt(drawn[:, 0]), draw / 2.0 * np.abs(run[:, 0]), atol=1e-9)


def test_a_record_is_left_out_of_a_fit_of_the_others():
    """Of integrators whose gains differ, each gets the mean gain of the others."""
    gains, records = (1.9, 2.0, 2.1, 2.4), []
    for gain in gains:
        shown = level()
        records.append(replace(shown, output=gain / 2.0 * shown.output))
    experiments = [prepare(record, Integrator(), SAMPLING) for record in records]
    blocks = left_out(Integrator(), experiments, {"gain": 1.0}, 1.0)
    assert [(block.record, block.samples.stop) for block in blocks] == [(k, experiments[k].samples) for k in range(4)]
    for block in blocks:
        others = np.mean([gain for k, gain in enumerate(gains) if k != block.record])
        assert block.system.named["gain"] == pytest.approx(others, abs=1e-3)


@dataclass(frozen=True, kw_only=True)
class LaggingValve(System):
    """x' = gain z, z' = u - z / 2 s: a level, and a valve that nothing shows."""

    states = ("level [m]", "valve [m/s]")
    inputs = ("flow [m/s]",)
    outputs = ("level [m]",)
    gain: float = bounded(2.0, 0.1, 10.0, unit="1")

    def law(self, x, u):
        return (self.gain * x[1], u[0] - 0.5 * x[1])


def test_a_record_is_left_out_of_fits_that_know_its_hidden_beginning():
    u = held_levels(0, 1001, hold=20)
    states = simulate(LaggingValve(), np.array([0.0, 3.0]), u[:-1], step=0.01)
    experiment = prepare(record_of(u, states[:, :1], 0.01), LaggingValve(), replace(SAMPLING, initial="estimated"))
    blocks = left_out(LaggingValve(), [experiment], {"gain": 1.0}, 1.0)
    assert [block.system.named["gain"] for block in blocks] == pytest.approx(len(blocks) * [2.0], rel=0.04)


def test_a_run_that_goes_farther_than_training_has_wider_bands(rig):
    record = bench(samples=4001)
    model = identify([record], rig, "linear", sampling=Sampling(), refine=True)
    experiment = experiment_of(model, record)
    farther = replace(experiment, inputs=3.0 * experiment.inputs, outputs=3.0 * experiment.outputs)
    same, wider = (bands_of(model, item)[1] for item in (experiment, farther))
    centre = model.fit["bands"]["outputs"]["position"]["centre"]
    growth = np.sqrt(np.mean((wider.run - centre) ** 2) / np.mean((same.run - centre) ** 2))
    assert np.median(wider.half) == pytest.approx(growth * np.median(same.half), rel=0.2)


def test_errors_that_remember_are_few():
    memory = 0.9
    errors = lfilter([1.0], [1.0, -memory], np.random.default_rng(0).normal(size=100000))
    assert correlation_time([errors]) == pytest.approx((1 + memory) / (1 - memory), rel=0.15)


def test_mean_squares_that_differ_have_the_freedom_of_their_chi_square():
    """That of n white errors has n degrees of freedom; blocks that are alike have many."""
    random = np.random.default_rng(0)
    assert freedom_of(list(random.normal(size=(20000, 8))), 1) == pytest.approx(8.0, rel=0.1)
    assert freedom_of(4 * [np.ones(10)], 4) > 1e12
    assert freedom_of([np.ones(10)], 1) == 0.0


def test_a_quantile_of_errors_of_records_that_differ_and_student_s_factor_hold_those_of_another_record():
    """Of records whose mean squares are chi-squares over n = 4; on average over many trials."""
    random, held = np.random.default_rng(0), []
    for _ in range(400):
        deviations = np.sqrt(random.chisquare(4, 7) / 4)
        errors = list(deviations[:6, None] * random.normal(size=(6, 300)))
        half = np.quantile(np.abs(errors), 0.9) * student_factor(freedom_of(errors, 6))
        held.append(2.0 * norm.cdf(half / deviations[6]) - 1.0)
    assert np.mean(held) == pytest.approx(0.9, abs=0.015)


def test_bands_of_few_errors_to_which_numbers_were_fitted_are_wider():
    errors = np.random.default_rng(0).normal(size=30)
    count, used = 30 / correlation_time([errors], centred=False), 4.0
    factor = np.sqrt(count / (count - used) * (1 + used / count))
    expected = factor * student.ppf(0.95, count - used) / norm.ppf(0.95)
    assert widening_of([errors], used) == pytest.approx(expected)
    assert widening_of([np.random.default_rng(0).normal(size=100000)], used) == pytest.approx(1.0, abs=1e-3)


def test_a_record_that_no_fit_saw_lies_within_its_bands(rig):
    """Of a linear system with white noise, whose model is true."""
    clean = bench(samples=8001)
    noise = 0.03 * clean.output.std() * np.random.default_rng(0).normal(size=clean.output.shape)
    record = replace(clean, output=clean.output + noise)
    model = identify([record], rig, "linear", sampling=Sampling(), part=Part(stop=0.6), refine=True)
    experiment = experiment_of(model, record, part=Part(start=0.6))
    half, ninety = bands_of(model, experiment)
    assert (half.level, ninety.level) == (0.5, 0.9)
    assert 0.3 < half.held(experiment.outputs, experiment.scored)[0] < 0.75
    assert 0.8 < ninety.held(experiment.outputs, experiment.scored)[0] <= 1.0
    assert np.all(ninety.half >= half.half)
    assert bands_of(replace(model, fit={}), experiment) == []
