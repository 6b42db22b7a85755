"""Samples of the exact MPC: closed loops of it, and where they are kept."""

import dataclasses

import numpy as np
import pytest
from hybrid_sysid_ros.control.policy.sample_store import SampleStore
from hybrid_sysid_ros.control.policy.sampling import Samples, drawn, sample
from hybrid_sysid_ros.control.policy.sampling_pool import SamplingPool
from small_policies import PROBLEM, SPREAD, model_of  # type: ignore[import-not-found]

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.policy.adaptation import Adaptation


def test_samples_are_answers_of_the_exact_mpc():
    model = model_of()
    samples = sample(model.system, PROBLEM, SPREAD, 7)
    assert len(samples.inputs) + samples.dropped == round(8.0 / PROBLEM.period)
    assert np.all(np.abs(samples.inputs) <= 10.0)
    assert np.max(np.abs(samples.previews)) <= 4.0 * PROBLEM.output_scale * (1 + 1e-9)
    assert len(np.unique(samples.disturbances)) < 15  # it jumps now and then
    expert = ExactMpc(model.system, PROBLEM)
    for k in range(0, len(samples.inputs), 10):
        expert.reset()
        again = expert.control(
            samples.states[k], samples.disturbances[k : k + 1], samples.previous[k : k + 1], samples.previews[k]
        )
        np.testing.assert_allclose(again.inputs[:, 0], samples.inputs[k], atol=2e-3)


def test_what_a_solver_does_not_solve_gives_no_samples(rig):
    hopeless = dataclasses.replace(PROBLEM, max_iterations=1)
    samples = sample(rig.system, hopeless, SPREAD, 7)
    assert len(samples.inputs) + samples.dropped == round(8.0 / PROBLEM.period)
    assert samples.dropped > 100


def test_plants_are_drawn_about_the_model_within_bounds():
    system, random = model_of().system, np.random.default_rng(0)
    values = np.array([drawn(system, 0.1, random).values for _ in range(2000)])
    for item, nominal, column in zip(system.parameters, system.values, values.T, strict=True):
        assert np.all((column >= item.low) & (column <= item.high))
        assert np.std(column) == pytest.approx(0.1 * abs(nominal), rel=0.1)
        assert np.mean(column) == pytest.approx(nominal, abs=0.01 * abs(nominal))
    np.testing.assert_array_equal(drawn(system, 0.0, random).values, system.values)


def test_other_plants_make_other_loops_for_the_same_mpc():
    system = model_of().system
    same, other = (sample(system, PROBLEM, dataclasses.replace(SPREAD, parameters=p), 7) for p in (0.0, 0.2))
    assert np.max(np.abs(same.previews[0] - other.previews[0])) < 1e-12
    assert np.max(np.abs(same.states[20] - other.states[20])) > 1e-4


def test_shifts_are_derivatives_of_the_plan_by_the_followed_parameters():
    """Against differences over a tenth of the step, of plans that are solved afresh."""
    system = model_of().system
    adaptation = Adaptation(names=("gain", "centre"), spread=(0.5, 0.2))
    samples = sample(system, PROBLEM, SPREAD, 7, adaptation=adaptation)
    assert samples.shifts.shape == (len(samples.inputs), 2, 4)
    inside = np.flatnonzero(np.all(np.abs(samples.inputs) < 9.0, axis=1))[::8]
    assert len(inside) > 5
    for index in range(2):
        pair = [ExactMpc(adaptation.shifted(system, index, side), PROBLEM, tolerance=1e-9) for side in (-0.05, 0.05)]
        for k in inside:
            question = (
                samples.states[k],
                samples.disturbances[k : k + 1],
                samples.previous[k : k + 1],
                samples.previews[k],
            )
            for mpc in pair:
                mpc.reset()
            low, high = (mpc.control(*question).inputs[:, 0] for mpc in pair)
            np.testing.assert_allclose(samples.shifts[k, index], (high - low) / 0.1, rtol=0.05, atol=0.02)


def test_the_offset_of_the_input_shifts_the_first_plan_one_to_one():
    """A beam's centre acts as an offset of its input: plans of low weight on changes move with it."""
    system = model_of().system
    problem = dataclasses.replace(PROBLEM, rate_weight=0.0, input_limit=1e3)
    adaptation = Adaptation(names=("centre",), spread=(0.2,))
    samples = sample(system, problem, SPREAD, 3, adaptation=adaptation)
    np.testing.assert_allclose(samples.shifts[:, 0], 0.2, atol=1e-3)


def test_slopes_by_features_say_of_a_linear_answer_what_those_by_questions_say():
    """u = s [x, d, u_previous, q] = (slopes by features) [x, d, u_previous, q - y], for any s."""
    samples = some_samples(3)
    questions = np.column_stack([samples.states, samples.disturbances, samples.previous, samples.previews])
    by_questions = np.sum(samples.slopes * questions, axis=1)
    for output in (0, 1):
        by_features = np.sum(samples.feature_slopes(output) * samples.features(output), axis=1)
        np.testing.assert_allclose(by_features, by_questions, rtol=1e-9)


def test_slopes_are_taken_of_a_share_of_the_answers():
    samples = sample(model_of().system, PROBLEM, SPREAD, 7, slope_share=0.5)
    known = np.isfinite(samples.slopes).all(axis=1)
    assert 0.3 < np.mean(known) < 0.7
    # Further up it is pulled down, with a reference further up it is driven there.
    inside = known & (np.abs(samples.inputs[:, 0]) < 9.0)
    assert np.all(samples.slopes[inside, 0] < 0)
    assert np.all(samples.slopes[inside, -PROBLEM.horizon :].sum(axis=1) > 0)


def test_a_loop_has_one_cost_and_it_goes_with_the_errors_of_the_loop():
    found = [sample(model_of().system, PROBLEM, SPREAD, seed) for seed in range(10)]
    errors = []
    for samples in found:
        assert len(np.unique(samples.costs)) == 1
        errors.append(np.mean((samples.states[:, 0] - samples.previews[:, 0]) ** 2))
    costs = [samples.costs[0] for samples in found]
    assert max(costs) > 10 * min(costs)
    assert np.corrcoef(np.log(costs), np.log(errors))[0, 1] > 0.9


def some_samples(seed):
    random = np.random.default_rng(seed)
    return Samples(
        states=random.normal(size=(5, 2)),
        disturbances=random.normal(size=5),
        previous=random.normal(size=5),
        previews=random.normal(size=(5, 4)),
        inputs=random.normal(size=(5, 4)),
        slopes=random.normal(size=(5, 8)),
        shifts=random.normal(size=(5, 0, 4)),
        costs=random.uniform(size=5),
        dropped=3,
    )


def test_stored_samples_are_found_again_if_their_purpose_is_the_same(tmp_path):
    store = SampleStore(tmp_path / "samples", "a model")
    assert store.find(1) is None
    store.keep(1, some_samples(1))
    found = SampleStore(tmp_path / "samples", "a model").find(1)
    assert found is not None
    for name in ("states", "disturbances", "previous", "previews", "inputs", "slopes", "shifts", "costs"):
        np.testing.assert_array_equal(getattr(found, name), getattr(some_samples(1), name))
    assert found.dropped == 3
    assert SampleStore(tmp_path / "samples", "another model").find(1) is None
    assert store.find(2) is None
    (file,) = (tmp_path / "samples").iterdir()
    file.write_bytes(file.read_bytes()[:100])
    assert store.find(1) is None
    store.remove()
    assert not (tmp_path / "samples").exists()


def few(seed: int) -> Samples:
    """Two samples, at once."""
    arrays = {item.name: np.full((2, 1), float(seed)) for item in dataclasses.fields(Samples) if item.name != "dropped"}
    return Samples(**arrays, dropped=0)


def test_loops_that_finish_after_an_interrupt_are_kept_too(tmp_path):
    def interrupt(done: int, of: int) -> None:
        raise KeyboardInterrupt

    store = SampleStore(tmp_path / "samples", "a model")
    with pytest.raises(KeyboardInterrupt), SamplingPool(1, store) as pool:
        pool.run(few, list(range(100)), interrupt)
    kept = [seed for seed in range(100) if store.find(seed) is not None]
    assert kept[:2] == [0, 1]  # the second was under way
