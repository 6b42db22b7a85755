"""What of a record is fitted and scored: its samples, its parts, and scores by hand."""

import numpy as np
import pytest

from hybrid_sysid_ros.identification import Part, prepare, score
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_bench import record_of


def test_averaged_inputs_are_means_over_each_step_and_sampled_ones_are_held():
    u = np.random.default_rng(0).normal(size=(2001, 1))
    record = record_of(u, np.sin(np.arange(2001) / 100.0)[:, None], 0.001)
    averaged = prepare(record, CamBeam(), Sampling(step=0.005, period=0.05))
    np.testing.assert_allclose(averaged.inputs[:, 0], [u[k : k + 5].mean() for k in range(0, 2000, 5)], rtol=1e-12)
    sampled = prepare(record, CamBeam(), Sampling(step=0.005, period=0.05, input="sampled"))
    np.testing.assert_array_equal(sampled.inputs[:, 0], u[:2000:50, 0].repeat(10))
    for experiment in (averaged, sampled):
        np.testing.assert_array_equal(experiment.outputs, record.output[::50])


def test_a_slow_record_holds_its_input_over_finer_steps():
    u = np.random.default_rng(0).normal(size=(41, 1))
    experiment = prepare(record_of(u, u, 0.05), CamBeam(), Sampling())
    np.testing.assert_array_equal(experiment.inputs[:, 0], u[:40, 0].repeat(10))


def test_the_velocity_of_a_cubic_is_exact():
    """A Savitzky-Golay filter of order 3 differentiates polynomials of degree 3 without error."""
    t = 0.001 * np.arange(2000)
    record = record_of(np.zeros((2000, 1)), (0.1 - 0.3 * t + 0.2 * t**3)[:, None], 0.001)
    states = prepare(record, CamBeam(), Sampling()).states
    np.testing.assert_allclose(states[:, 1], (-0.3 + 0.6 * t**2)[::50], atol=1e-9)
    np.testing.assert_array_equal(states[:, 0], record.output[::50, 0])


def test_scores_by_hand():
    # Errors 1, 0, -1, 0; deviations from the mean -1.5, -.5, .5, 1.5.
    scores = score(np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.0, 2.0, 4.0, 4.0]))
    assert scores.r2 == pytest.approx(1 - 2 / 5)
    assert scores.rmse == pytest.approx(0.5**0.5)
    assert scores.fit_percent == pytest.approx(100 * (1 - (2 / 5) ** 0.5))


def test_a_simulation_that_diverges_scores_minus_infinity():
    assert score(np.array([0.0, 1.0]), np.array([0.0, np.inf])).r2 == -np.inf
    assert score(np.array([0.0, 1.0]), np.array([np.nan, 0.0])).r2 == -np.inf
    assert score(np.array([0.0, 1.0]), np.array([0.0, 1e200])).r2 == -np.inf


@pytest.mark.parametrize(("text", "expected"), [("0:0.5", Part(stop=0.5)), ("0.5:1", Part(start=0.5)), ("0:1", Part())])
def test_a_part_is_two_fractions(text, expected):
    assert Part.parse(text) == expected


@pytest.mark.parametrize("text", ["", "0.5", "a:b", "0.5:0.5", "1:0", "-1:1", "0:2", "0:nan", "0:1:2"])
def test_anything_else_is_no_part(text):
    with pytest.raises(UserError, match="part"):
        Part.parse(text)
