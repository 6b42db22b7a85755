"""k-step-ahead errors against school physics and a loop over the samples."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.shared.horizons import k_step_errors
from hybrid_sysid_ros.identification import PreparedRecord, score
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.support.errors import UserError
from studies.beam_lecture.report import averaged

SAMPLING = Sampling(step=0.01, period=0.05)


def experiment(outputs, states, inputs):
    return PreparedRecord(name="block", sampling=SAMPLING, inputs=inputs, outputs=outputs, states=states)


def block(slider):
    return dataclasses.replace(slider, friction=0.0, input_delay=0.013)


def pushed(system, offset=0.0, seed=0, samples=101):
    """A frictionless block under a random push; ``offset`` is a push that the record does not show."""
    push = np.random.default_rng(seed).normal(size=((samples - 1) * SAMPLING.every, 1))
    states = simulate(system, np.array([0.3, -0.2]), push + offset, step=SAMPLING.step, every=SAMPLING.every)
    return experiment(states[:, :1], states, push)


def test_a_hidden_push_grows_as_the_square_of_time(slider):
    # x_n - x_n' of semi-implicit Euler is a h^2 (1 + 2 + ... + n)
    errors = k_step_errors(block(slider), pushed(block(slider), offset=0.7), [1, 3, 10, 50])
    steps = SAMPLING.every * np.array([1, 3, 10, 50])
    np.testing.assert_allclose(errors.rmse, 0.7 * SAMPLING.step**2 * steps * (steps + 1) / 2, rtol=1e-9)
    np.testing.assert_allclose(errors.seconds, [0.05, 0.15, 0.5, 2.5])


def test_an_exact_model_has_no_error_even_with_its_delay(slider):
    errors = k_step_errors(block(slider), pushed(block(slider)), [1, 7, 60])
    np.testing.assert_allclose(errors.rmse, 0.0, atol=1e-12)
    np.testing.assert_allclose(errors.r2, 1.0)
    assert errors.free_run.r2 == pytest.approx(1.0)


def test_noise_of_the_initial_state_and_of_the_target_add(slider):
    # position noise s in both, the speed known: the error is s(t + k) - s(t), of deviation s sqrt 2
    exact = pushed(block(slider), samples=20_001)
    noise = np.random.default_rng(5).normal(scale=1e-3, size=exact.samples)
    noisy = experiment(exact.outputs + noise[:, None], exact.states + np.outer(noise, [1.0, 0.0]), exact.inputs)
    errors = k_step_errors(block(slider), noisy, [1, 20, 100])
    np.testing.assert_allclose(errors.rmse, np.sqrt(2) * 1e-3, rtol=0.03)


def test_the_errors_are_those_of_a_loop_over_the_samples(slider):
    item = pushed(block(slider), offset=0.7)
    rubbing = dataclasses.replace(slider, friction=0.5)  # without a delay: the loop below has no past inputs
    errors = k_step_errors(rubbing, item, [2, 9])
    found: dict[int, list[float]] = {2: [], 9: []}
    begins = range(item.samples - 9)
    for begin in begins:
        inputs = item.inputs[begin * SAMPLING.every :]
        run = simulate(rubbing, item.states[begin], inputs, step=SAMPLING.step, every=SAMPLING.every)
        for k in found:
            found[k].append(run[k, 0] - item.outputs[begin + k, 0])
    expected = [np.sqrt(np.mean(np.square(found[k]))) for k in (2, 9)]
    np.testing.assert_allclose(errors.rmse, expected, rtol=1e-10)
    np.testing.assert_allclose(errors.r2, 1 - np.square(expected) / np.var(item.outputs), rtol=1e-10)
    assert errors.rollouts == len(begins)


def test_the_longest_horizon_is_the_end_of_the_free_run(slider):
    item = pushed(block(slider), offset=0.1)
    errors = k_step_errors(block(slider), item, [item.samples - 1])
    run = simulate(block(slider), item.states[0], item.inputs, step=SAMPLING.step, every=SAMPLING.every)[:, 0]
    assert errors.rmse[0] == pytest.approx(abs(run[-1] - item.outputs[-1, 0]))
    assert errors.free_run == score(item.outputs[:, 0], run)


def test_default_horizons_begin_at_one_sample(slider):
    errors = k_step_errors(block(slider), pushed(block(slider)))
    assert (errors.horizons[0], errors.horizons[-1]) == (1, 50)
    assert np.all(np.diff(errors.horizons) > 0)


@pytest.mark.parametrize("horizons", [[], [0], [101], [-1, 5]])
def test_horizons_beyond_the_record_are_refused(slider, horizons):
    with pytest.raises(UserError, match="block: horizons must be 1 to 100 samples"):
        k_step_errors(block(slider), pushed(block(slider)), horizons)


def test_an_averaged_curve_is_that_of_all_errors_together(slider):
    items = [pushed(block(slider), offset=offset) for offset in (0.2, 0.7)]
    chosen = zip(items, ([1, 5, 20], [5, 20, 40]), strict=True)
    curves = [k_step_errors(block(slider), item, horizons) for item, horizons in chosen]
    mean = averaged("both", curves)
    np.testing.assert_array_equal(mean.horizons, [5, 20])
    pushes = np.sqrt((0.2**2 + 0.7**2) / 2)  # the error is proportional to the push
    steps = SAMPLING.every * np.array([5, 20])
    np.testing.assert_allclose(mean.rmse, pushes * SAMPLING.step**2 * steps * (steps + 1) / 2, rtol=1e-9)
    assert mean.rollouts == sum(curve.rollouts for curve in curves)
    with pytest.raises(UserError, match="alone: the records have no common horizon"):
        averaged("alone", [])
