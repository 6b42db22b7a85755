"""Starts of records: the state at which a simulation begins, against closed forms."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from hybrid_sysid_ros.core import System, bounded, simulate
from hybrid_sysid_ros.identification import free_run, prepare
from hybrid_sysid_ros.identification.experiment import handling_of, noise_of, resample
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.identification.starts import initial_state, start_of
from hybrid_sysid_ros.identification.validation.run_quality import run_quality
from hybrid_sysid_ros.identification.validation.scores import score_free_run
from hybrid_sysid_ros.identification.validation.unstable import predictions
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_bench import held_levels, record_of

SAMPLING = Sampling(step=0.01, period=0.05)
NOISE = 0.01


@dataclass(frozen=True, kw_only=True)
class Cart(System):
    """A cart on which a force acts: it integrates twice."""

    states = ("position [m]", "velocity [m/s]")
    inputs = ("force [N]",)
    gain: float = bounded(1.0, 0.1, 10.0, unit="1/kg")

    def law(self, x, u):
        return x[1], self.gain * u[0]


@dataclass(frozen=True, kw_only=True)
class Tanks(System):
    """Two tanks, one above the other: the upper one's level is not measured."""

    states = ("upper [m]", "lower [m]")
    inputs = ("pump [V]",)
    outputs = ("lower [m]",)
    rate: float = bounded(0.5, 0.05, 5.0, unit="1/s")

    def law(self, x, u):
        return self.rate * (u[0] - x[0]), self.rate * (x[0] - x[1])


def recorded(system, first, *, samples=1001, noise=0.0, seed=0):
    u = held_levels(seed, samples, hold=40)
    states = simulate(system, np.array(first), u[:-1], step=0.01)
    measured = states[:, [[item.name for item in system.states].index(item.name) for item in system.outputs]]
    return record_of(u, measured + noise * np.random.default_rng(seed).normal(size=measured.shape), 0.01)


def test_a_start_is_the_line_through_the_first_samples():
    """Without a force the positions are a line in time, whose ends least squares know by a closed form."""
    record = recorded(Cart(), (0.3, 0.2), noise=NOISE)
    still = replace(record, input=np.zeros_like(record.input), output=0.3 + 0.2 * record.time[:, None])
    noisy = replace(still, output=still.output + NOISE * np.random.default_rng(1).normal(size=still.output.shape))
    experiment = prepare(noisy, Cart(), SAMPLING)
    start, times, deviations = start_of(Cart(), experiment), np.arange(41) * 0.05, experiment.deviations
    assert deviations is not None
    weights = np.diag([*np.full(41, 1 / NOISE**2), 1 / NOISE**2, 1 / deviations[1] ** 2])
    matrix = np.vstack([np.column_stack([np.ones(41), times]), np.eye(2)])
    normal = matrix.T @ weights @ matrix
    values = np.concatenate([experiment.outputs[:41, 0], experiment.states[0]])
    np.testing.assert_allclose(start.state, np.linalg.solve(normal, matrix.T @ weights @ values), atol=2e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(start.covariance)), np.sqrt(np.diag(np.linalg.inv(normal))), rtol=0.3)
    first = experiment.states[0]
    assert abs(start.state[1] - 0.2) < 0.1 * abs(first[1] - 0.2)


def test_a_level_that_no_sensor_shows_is_found_wherever_it_begins():
    for level in (-3.0, 0.0, 40.0):
        record = recorded(Tanks(), (level, 0.5), noise=1e-3)
        assert initial_state(Tanks(), prepare(record, Tanks(), SAMPLING))[0] == pytest.approx(level, abs=0.05)


def test_a_start_may_be_the_first_sample_or_rest_or_given():
    record = recorded(Cart(), (0.3, 0.2), noise=NOISE)

    def start(initial):
        return initial_state(Cart(), prepare(record, Cart(), replace(SAMPLING, initial=initial)))

    first = prepare(record, Cart(), SAMPLING).states[0]
    np.testing.assert_array_equal(start("first"), first)
    np.testing.assert_array_equal(start("rest"), [first[0], 0.0])
    assert start("velocity=0.25")[1] == 0.25
    np.testing.assert_array_equal(start("velocity=0.25, position=1"), [1.0, 0.25])
    with pytest.raises(UserError, match="no state speed; the model's states are position, velocity"):
        start("speed=1")
    for wrong in ("first sample", "velocity=fast", "velocity=nan", ""):
        with pytest.raises(UserError, match=r"initial .* is unknown: write estimated, first, rest"):
            replace(SAMPLING, initial=wrong)


def test_a_fit_and_a_score_begin_alike():
    record = recorded(Cart(gain=2.0), (0.3, 0.2), noise=NOISE)
    experiment = prepare(record, Cart(), SAMPLING)
    found = fit(Cart(), [experiment])
    assert found.system.named["gain"] == pytest.approx(2.0, rel=0.01)
    begun = experiment.states[0] + [found.nuisances[name][0] for name in ("position", "velocity")]
    np.testing.assert_allclose(initial_state(found.system, experiment), begun, atol=2 * NOISE)
    given = prepare(record, Cart(), replace(SAMPLING, initial="first"))
    assert not fit(Cart(), [given]).nuisances


def test_a_warm_up_is_not_scored():
    record = recorded(Cart(), (0.3, 0.2))
    spoilt = replace(record, output=record.output + np.where(record.time < 1.0, 5.0, 0.0)[:, None])
    sampling = replace(SAMPLING, initial="position=0.3,velocity=0.2")
    rmse = [score_free_run(Cart(), prepare(spoilt, Cart(), replace(sampling, warm_up=count))).rmse for count in (0, 20)]
    assert rmse[0] > 1.0
    assert rmse[1] < 1e-9
    with pytest.raises(UserError, match="none of its 201 samples is left after a warm-up of 500"):
        score_free_run(Cart(), prepare(record, Cart(), replace(sampling, warm_up=500)))


def test_noise_is_what_differs_from_a_smooth_curve():
    time = np.arange(4001) * 0.001
    noise = 0.02 * np.random.default_rng(0).normal(size=(4001, 1))
    record = record_of(np.ones((4001, 1)), np.sin(2 * time)[:, None] + noise, 0.001)
    assert noise_of(record)[0] == pytest.approx(0.02, rel=0.05)


def test_an_interpolated_input_is_exact_for_lines():
    """A cart under a force that grows with time: its velocity is a parabola, its position a cubic."""
    time = np.arange(201) * 0.05
    record = record_of(time[:, None], (time**3 / 6)[:, None], 0.05)
    for step in (0.05, 0.01):
        given = Sampling(step=step, period=0.05, input="interpolated", initial="position=0, velocity=0")
        experiment = prepare(record, Cart(), given)
        np.testing.assert_allclose(np.cumsum(experiment.inputs[:, 0])[-1] * step, 50.0, rtol=1e-9)
        error = np.abs(free_run(Cart(), experiment) - experiment.outputs).max()
        assert error < 30.0 * step  # semi-implicit Euler: half a step of the velocity


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        (lambda n: sum(np.sin(2 * np.pi * f * n / 610.0 + f**2) for f in range(1, 200, 2)), "interpolated"),
        (lambda n: np.random.default_rng(0).normal(size=len(n)), "averaged"),
        (lambda n: held_levels(0, len(n), hold=20)[:, 0], "averaged"),
    ],
)
def test_a_band_limited_input_is_told_from_a_held_one(signal, expected):
    u = signal(np.arange(4096))[:, None]
    record = record_of(u, np.cumsum(u, axis=0), 1 / 610.0)
    assert handling_of([record], Sampling(step=1 / 610.0, period=1 / 610.0)) == expected
    fine = Sampling(step=10 / 610.0, period=10 / 610.0)
    assert handling_of([record], fine) == "averaged"
    auto = resample(record, Sampling(step=1 / 610.0, period=1 / 610.0, input="auto")).inputs
    plain = resample(record, Sampling(step=1 / 610.0, period=1 / 610.0, input=expected)).inputs
    np.testing.assert_array_equal(auto, plain)


@pytest.mark.parametrize(("spoil", "kind"), [(-1.0, "sign"), (57.3, "unit"), (1.0, "")])
def test_wrong_units_and_signs_are_told_from_good_runs(spoil, kind):
    record = recorded(Tanks(), (0.0, 0.5), samples=4001, noise=1e-3)
    quality = run_quality(Tanks(), prepare(replace(record, output=spoil * record.output), Tanks(), SAMPLING))
    assert quality.kind == kind
    assert quality.judged


@pytest.mark.parametrize("offset", [0.4, -0.4, 0.001])
def test_a_zero_that_was_set_anew_is_told_from_a_poor_model(offset):
    record = recorded(Tanks(), (0.0, 0.5), samples=4001, noise=1e-3)
    quality = run_quality(Tanks(), prepare(replace(record, output=record.output + offset), Tanks(), SAMPLING))
    assert quality.kind == ("offset" if abs(offset) > 0.1 else "")
    if quality.kind:
        way = "above" if offset > 0.0 else "below"
        assert re.search(rf"lower is 0.(39|40)\d* m {way} the run throughout: was its zero set anew", quality.sentence)


def test_a_system_that_integrates_is_not_told_to_be_in_other_units():
    """The cart of the known gain: its start and a thousandth of the force decide where it is after 200 s."""
    record = recorded(Cart(), (0.3, 0.2), samples=20001, noise=NOISE)
    x, random = np.array([0.3, 0.2]), np.random.default_rng(2)
    for k in range(record.samples):  # held near zero by a feedback
        record.output[k, 0] = x[0] + NOISE * random.normal()
        record.input[k] -= 0.5 * x[0] + x[1]
        x = simulate(Cart(), x, record.input[k : k + 1], step=0.01)[-1]
    quality = run_quality(Cart(), prepare(record, Cart(), SAMPLING))
    assert quality.kind == "integrates"
    assert "it integrates" in quality.sentence
    ahead = predictions(Cart(), prepare(record, Cart(), SAMPLING), None)
    assert [item.seconds for item in ahead] == [1.0, 5.0, 20.0]
    assert ahead[0].scores.r2 > 0.99
