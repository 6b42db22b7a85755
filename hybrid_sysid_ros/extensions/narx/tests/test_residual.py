"""Hybrids by residual: their recursion, its poles, their fit, and what refuses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.core import Dry, Sensitivities, System, rollouts, simulate
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.estimation.extended_kalman_filter import ExtendedKalmanFilter
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.extensions.narx.residual_fit import ResidualSequence, check_forgets, initial_guess, levinson
from hybrid_sysid_ros.extensions.narx.residual_hybrid import RADIUS, ResidualHybrid, averaged_residual, coefficients
from hybrid_sysid_ros.extensions.narx.tests.systems import residual
from hybrid_sysid_ros.extensions.report.stages import compare_stages
from hybrid_sysid_ros.identification import PreparedRecord, free_run
from hybrid_sysid_ros.identification.experiment import ResampledRecord
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models.hybrid_system import CLIP
from hybrid_sysid_ros.models.structure import options_of, structure_of
from hybrid_sysid_ros.support.errors import UserError

SAMPLING = Sampling(step=0.005, period=0.01)


@dataclass(frozen=True, kw_only=True)
class Belt(System):
    """Two pulleys on a belt: the first one rubs, the second one is pushed as well; its tension is measured."""

    states = ("first [rad]", "second [rad]", "first_rate [rad/s]", "second_rate [rad/s]")
    inputs = ("drive [rad/s^2]", "push [rad/s^2]")
    outputs = ("first", "tension [rad/s^2]")
    contacts = (Dry(on="first_rate", level=2.0, viscous=1.0),)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        tension = 50.0 * (x[0] - x[1])
        return x[2], x[3], u[0] - 10.0 * x[0] - tension, u[1] + tension - 0.5 * x[3] - 10.0 * x[1]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[0], 50.0 * (x[0] - x[1])


def drive(steps: int, seed: int = 0, hold: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-20.0, 20.0, (steps // hold + 1, 2)).repeat(hold, axis=0)[:steps]


def along(system: System, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States and outputs at every step, from rest."""
    starts = np.array([[0, 0, len(inputs) + 1, 0]])
    return rollouts(system, starts, np.zeros((1, len(system.states))), inputs, step=0.005)


# The recursion


def softsign(x: np.ndarray) -> np.ndarray:
    return x / (1.0 + np.abs(x))


def test_a_free_run_is_the_gray_box_s_and_the_recursion_beside_it() -> None:
    """In plain numpy, from the gray box's own free run: what is added never acts on the physics."""
    physics, inputs = Belt(), drive(600)
    system = residual(physics)
    x, y = along(physics, inputs)
    _, (first, second) = system.exponents[0], system.exponents[0]
    width, units = len(system.regressors), system.units
    scales, sizes = np.array(system.scales[:width]), np.array(system.scales[width:])
    theta, weights = system.learned[:4].reshape(2, 2), system.learned[4:].reshape(units, width + 3)
    (k1, k2), (l1, l2) = np.reshape(system.reflections, (2, 2))
    a = np.array([[k1 - k2 * k1, k2], [l1 - l2 * l1, l2]]) * [RADIUS, RADIUS**2]
    e, past, found = np.zeros((2, 2)), np.zeros(2), []  # outputs x lags
    for k, u in enumerate(inputs):
        found.append(y[k] + e[:, 0])
        r = np.array([*x[k], *u, *past, *(v for lags in e for v in (lags[0], lags[0] - lags[1]))]) / scales
        held = np.clip(r, -CLIP, CLIP)
        network = weights[:, -2:].T @ softsign(weights[:, :width] @ r + weights[:, width])
        driven = [t[0] * np.prod(r**first) + t[1] * np.prod(held**second) for t in theta]
        following = np.sum(a * e, axis=1) + sizes * (driven + network)
        e, past = np.column_stack([following, e[:, 0]]), u
    states, outputs = along(system, inputs)
    np.testing.assert_allclose(outputs[:-1], found, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(states[:, :4], x)
    assert np.std(outputs - y, axis=0).min() > 1e-3  # something was added


def test_its_derivatives_are_what_simulations_differ_by() -> None:
    system, inputs = residual(Belt()), drive(60)
    sensitivities = Sensitivities(system, states=[4, 7])
    jacobian, starts = np.empty((61, 2, sensitivities.count)), np.array([[0, 0, 61, 0]])
    begin = np.full((1, len(system.states)), 0.01)
    sensitivities.rollouts(system, starts, begin, inputs, step=0.005, out=jacobian, every=1)

    def outputs(moved: ResidualHybrid, state: np.ndarray) -> np.ndarray:
        return rollouts(moved, starts, state, inputs, step=0.005)[1]

    h, free = 1e-6, len(system.reflections)
    for column in range(sensitivities.count):
        found = []
        for change in (h, -h):
            moved, state = system, begin.copy()
            if column < free:
                shifted = np.array(system.reflections)
                shifted[column] += change
                moved = replace(system, reflections=tuple(shifted.tolist()))
            elif column < free + len(system.weights):
                weights = system.weights.copy()
                weights[column - free] += change
                moved = system.with_weights(weights)
            else:
                state[0, [4, 7][column - free - len(system.weights)]] += change
            found.append(outputs(moved, state))
        np.testing.assert_allclose(jacobian[:, :, column], (found[0] - found[1]) / (2 * h), rtol=1e-4, atol=1e-6)


def test_the_mean_of_models_runs_in_their_mean() -> None:
    """Where what drives a residual does not see it and the memory is one, a free run is linear in what drives it."""
    first, second = residual(Belt(), seed=1), residual(Belt(), seed=2)
    second = replace(second, reflections=first.reflections, scales=first.scales)
    seen = len(first.regressors) - 4  # the rest are residuals and their changes

    def deaf(system: ResidualHybrid) -> ResidualHybrid:
        weights = system.weights.copy()
        weights[[1, 3]] = 0.0  # products with a residual's change
        weights[4:].reshape(system.units, -1)[:, seen : seen + 4] = 0.0
        return system.with_weights(weights)

    inputs, members = drive(400), [deaf(first), deaf(second)]
    runs = [along(member, inputs)[1] for member in members]
    mean = averaged_residual(members)
    assert mean.units == 2 * first.units
    np.testing.assert_allclose(along(mean, inputs)[1], np.mean(runs, axis=0), rtol=1e-9, atol=1e-12)
    assert np.std(runs[0] - runs[1]) > 1e-3


def test_a_network_comes_beside_what_is_learnt_already() -> None:
    system = residual(Belt())
    renewed = system.with_network(5, seed=3)
    assert renewed.units == 5
    np.testing.assert_array_equal(renewed.weights[:4], system.weights[:4])
    np.testing.assert_array_equal(renewed.weights, system.with_network(2, seed=1).with_network(5, seed=3).weights)


# Its stability


def test_every_reflection_coefficient_within_one_gives_poles_within_the_radius() -> None:
    random = np.random.default_rng(0)
    for order in range(1, 7):
        for _ in range(50):
            a = coefficients(random.uniform(-1.0, 1.0, order).tolist())
            assert np.abs(np.roots([1.0, *(-value for value in a)])).max() <= RADIUS + 1e-6


def test_the_memory_of_a_series_is_that_of_the_yule_walker_equations() -> None:
    series = np.random.default_rng(0).normal(size=500).cumsum()
    reported = [np.dot(series[: 500 - lag], series[lag:]) for lag in range(4)]
    expected = solve_toeplitz(reported[:3], reported[1:])
    found = coefficients(levinson([series], 3))
    np.testing.assert_allclose(found, expected * RADIUS ** np.arange(1, 4), rtol=1e-9)


def test_whatever_its_weights_it_stays_bounded() -> None:
    """A network and products of enormous weights: |e| <= sup |what is added| sum |h|, h the response of the memory."""
    wild = residual(Belt())
    learned = 1e3 * wild.learned
    learned[[0, 2]] = 0.0  # the linear terms
    wild = wild.with_weights(learned)
    inputs, width = drive(5000), len(wild.regressors)
    states, _ = along(wild, inputs)
    for i in range(2):
        a = coefficients(wild.reflections[2 * i : 2 * i + 2])
        response = lfilter([1.0], [1.0, *(-value for value in a)], np.eye(1, 20_000)[0])
        network = np.abs(learned[4:].reshape(wild.units, -1)[:, width + 1 + i]).sum()
        added = wild.scales[width + i] * (abs(learned[2 * i + 1]) * CLIP**2 + network)
        assert np.abs(states[:, 4 + 2 * i]).max() <= added * np.sum(np.abs(response))


def test_a_pole_outside_of_the_circle_is_refused() -> None:
    system = residual(Belt())
    with pytest.raises(UserError, match=r"reflection_2_first = 1\.2: .* outside of \[-1, 1\]"):
        replace(system, reflections=(0.5, 1.2, 0.5, 0.5)).check()


# The fit

TRUE = np.array([1.7, -0.74])  # poles of .93 and .77, within RADIUS
GAIN = 2e-3


def reported(seed: int, steps: int = 3000, noise: float = 1e-5) -> PreparedRecord:
    """The belt with a residual e(k + 1) = 1.7 e(k) - .74 e(k - 1) + .002 (drive(k) - drive(k - 1) / 2) on its angle."""
    inputs = drive(steps, seed)
    _, y = along(Belt(), inputs)
    e, before = [0.0, 0.0], inputs[0, 0]
    for u in inputs[:, 0]:
        e.append(TRUE @ e[:-3:-1] + GAIN * (u - 0.5 * before))
        before = u
    y[:, 0] += e[1:]
    y += noise * np.random.default_rng(seed).normal(size=y.shape)
    outputs = np.ascontiguousarray(y[::2])
    states = Belt().record_map().states_from_record(outputs, np.zeros_like(outputs), np.zeros((len(outputs), 2)))
    states[0] = 0.0
    return PreparedRecord(name=f"belt {seed}", sampling=SAMPLING, inputs=inputs, outputs=outputs, states=states)


def fitted(**options: float) -> tuple[ResidualHybrid, list[ResidualSequence]]:
    chosen = {name: option.default for name, option in options_of("residual", Belt()).items()} | options
    sequences = [ResidualSequence.of(Belt(), reported(seed)) for seed in (0, 1)]
    system = initial_guess(Belt(), sequences, chosen)
    held = [item.name for item in Belt().parameters]
    found = fit(system, [item.initialised(system) for item in sequences], ridge=1e-6, hold=held).system
    assert isinstance(found, ResidualHybrid)
    return found, sequences


@pytest.mark.slow
def test_a_known_residual_comes_back() -> None:
    """Two poles and two past inputs: its poles, and its free run under inputs that no fit saw."""
    system, sequences = fitted(units=0, output_lags=2)
    check_forgets(system, sequences)
    np.testing.assert_allclose(coefficients(system.reflections[:2]), TRUE, atol=2e-3)
    unseen = reported(7)
    prepared = replace(
        unseen, states=system.record_map().states_from_record(unseen.outputs, 0.0 * unseen.outputs, np.zeros((1501, 2)))
    )
    prepared.states[0] = 0.0
    error = prepared.outputs - free_run(system, prepared)
    before = unseen.outputs - free_run(Belt(), unseen)
    assert np.std(error[:, 0]) < 0.01 * np.std(before[:, 0])


def test_its_three_steps_are_reported() -> None:
    """What the gray box leaves follows the input, what the true recursion leaves does not."""
    system, _ = fitted(units=0, output_lags=2)
    unseen = reported(7)
    means = unseen.inputs.reshape(unseen.samples - 1, -1, 2).mean(axis=1)
    record = ResampledRecord(
        name=unseen.name,
        sampling=SAMPLING,
        inputs=unseen.inputs,
        outputs=np.concatenate([np.zeros((1, 2)), unseen.outputs[1:]]),  # it begins at rest
        rates=0.0 * unseen.outputs,
        means=np.concatenate([np.zeros((1, 2)), means[1:], means[-1:]]),
        measured=None,
        alias=np.zeros(2),
        noise=np.zeros(2),
        rate_noise=np.zeros(2),
    )
    stages = structure_of("residual", Belt()).stages(system)
    rows = {(row.stage, row.output): row for row in compare_stages(stages, record)}
    before, after = rows["gray box", "first"], rows["with its residual", "first"]
    assert not before.random
    assert before.independence.outside > 10
    assert after.scores.r2 > before.scores.r2
    assert after.independence.outside <= 3
    np.testing.assert_allclose(
        before.scores.rmse, np.std(unseen.outputs[:, 0] - free_run(Belt(), unseen)[:, 0]), rtol=0.1
    )


def test_a_residual_that_swings_by_itself_is_refused() -> None:
    """Two levels hold themselves: e+ = .5 e + .5 S n(e), n steep: bounded, but it never forgets where it began."""
    sequences = [ResidualSequence.of(Belt(), reported(0))]
    base = residual(Belt())
    width = len(base.regressors)
    weights = np.zeros((1, width + 3))
    weights[0, 8], weights[0, width + 1] = 100.0, 1.0
    scales = (*np.ones(width), 0.5 * np.std(sequences[0].errors[:, 0]), 1e-3)
    system = replace(
        base, units=1, exponents=((), ()), reflections=(0.5, 0.0, 0.5, 0.0), scales=scales, learned=weights.ravel()
    )
    with pytest.raises(UserError, match="does not die away"):
        check_forgets(system, sequences)
    check_forgets(system.with_weights(0.0 * system.weights), sequences)


# Where it runs


def test_between_its_samples_it_goes_on_a_straight_line() -> None:
    system, inputs = residual(Belt()), drive(1)
    begin = np.random.default_rng(0).normal(size=len(system.states))
    whole, half = (simulate(system, begin, inputs, step=step)[-1] for step in (0.005, 0.0025))
    memory = slice(4, 4 + len(system.added_states))
    np.testing.assert_allclose(half[memory], 0.5 * (begin + whole)[memory], rtol=1e-12)


def test_an_mpc_and_an_estimator_take_its_steps_or_none() -> None:
    system = residual(Belt())
    problem = ControlProblem(
        horizon=5, period=0.01, substeps=2, output_weights=(1.0, 0.0), input_low=(-1.0,), input_high=(1.0,)
    )
    assert problem.sized(system).substeps == 2
    with pytest.raises(UserError, match=r"ResidualHybrid steps by 0\.005 s, the problem by 0\.01 s"):
        replace(problem, substeps=1).sized(system)
    tuning = Tuning(
        measurement_noise=(0.01,), process_noise=(0.01,), disturbance_noise=(0.0,), disturbance_limit=(1.0,)
    )
    ExtendedKalmanFilter(system, tuning, period=0.01)
    with pytest.raises(UserError, match=r"steps by 0\.005 s: measurements must come whole steps apart, not 0\.0075 s"):
        ExtendedKalmanFilter(system, tuning, period=0.0075)
