"""Whether the estimators are as sure as they may be, and whether their mathematics is what their sources say."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from hybrid_sysid_ros.core import one_step
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.estimation import Tuning, estimator_class
from hybrid_sysid_ros.estimation.belief import solve_triangular
from hybrid_sysid_ros.estimation.consistency import band, normalised_errors
from hybrid_sysid_ros.estimation.extended_kalman_filter import triangle
from hybrid_sysid_ros.extensions.estimators.moving_horizon_estimator import solve_transposed
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.extensions import targets

PERIOD = 0.005

# The rig's equation, which is compiled anyway, as other plants.
UNIT: dict[str, float] = {"gain": 1.0, "centre": 0.0, "input_delay": 0.0, "asymmetry": 0.0, "stribeck_excess": 0.0}
PULL = CamBeam(
    stiffness=10.0,
    damping=1.0,
    coulomb=0.0,
    quadratic_stiffness=4.0,
    cam_curvature=0.5,
    range_low=-1.0,
    range_high=1.0,
    range_speed=100.0,
    **UNIT,
)
"""A mass on a crank and a spring of stiffness 2 to 18 where it goes. Smooth, and far from linear."""
BLOCK = CamBeam(
    stiffness=0.0,
    damping=0.0,
    coulomb=3.0,
    quadratic_stiffness=0.0,
    cam_curvature=0.0,
    friction_slope=0.0,
    friction_curvature=0.0,
    **UNIT,
)
"""v' = u - 3 sgn v: a block on a table."""
TUNING = Tuning(
    measurement_noise=(0.02,),
    process_noise=(1e-3, 0.3),
    disturbance_noise=(0.2,),
    disturbance_limit=(1e3,),
    hum_hertz=(0.0,),
    hum_amplitude=(0.0,),
    hum_noise=(0.0,),
    gate=1e9,
    patience=5,
)
FORCED = dataclasses.replace(TUNING, process_noise=(1e-3, 0.05), input_noise=(0.3,))


def advanced(z, u, system=PULL):
    """The system's own step with a disturbance, z = [q, v, d]."""
    return np.array([*one_step(system, z[:2], np.array([u + z[2]]), step=PERIOD), z[2]])


def drawn(tuning, seed, samples, system=PULL):
    """A run of a plant drawn from what the tuning says, the start included: measurements, inputs and states."""
    random = np.random.default_rng(seed)
    steps = np.sqrt(PERIOD) * np.array([*tuning.process_noise, *tuning.disturbance_noise])
    z = 10 * steps / np.sqrt(PERIOD) * random.normal(size=3)
    z[0] = 0.0
    inputs = np.repeat(random.uniform(-12.0, 12.0, samples // 50 + 1), 50)[:samples]
    measured, states = [], []
    for u in inputs:
        measured.append(z[0] + tuning.measurement_noise[0] * random.normal())
        states.append(z)
        force = tuning.input_noise[0] / np.sqrt(PERIOD) * random.normal()
        push = np.array([0.0, 0.0, force])
        z = advanced(z + push, u, system) - push + steps * random.normal(size=3)
    return np.array(measured), np.roll(inputs, 1), np.array(states)


PLANTS = {"plain": (TUNING, PULL), "forced": (FORCED, PULL), "sticking": (FORCED, BLOCK)}


@cache
def run_of(plant, seed):
    """A run that every method is given."""
    tuning, system = PLANTS[plant]
    return drawn(tuning, seed, 400, system)


@kernel
def triangle_of(rows, root):
    triangle(rows, len(rows), root)


@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("method", targets("estimators"))
def test_squared_errors_of_a_plant_as_the_filter_believes_it_to_be_are_in_their_band(method, plant):
    """Mean of 40 independent runs at some moments, chi-square of 120 degrees of freedom; NIS over all."""
    tuning, system = PLANTS[plant]
    moments, squares, errors, covariances = [50, 100, 200, 300, 399], [], [], []
    for seed in range(40):
        measured, inputs, states = run_of(plant, seed)
        ours = estimator_class(method)(system, tuning, period=PERIOD)
        estimates = [ours.update(k * PERIOD, measured[k : k + 1], inputs[k : k + 1]) for k in range(len(measured))]
        errors.append([np.array([*estimates[k].state, *estimates[k].disturbance]) - states[k] for k in moments])
        covariances.append([estimates[k].covariance[:3, :3] for k in moments])
        squares += [estimate.normalised_innovation for estimate in estimates[50:]]
    mean = normalised_errors(np.array(errors), np.array(covariances)).mean(axis=0)
    low, high = chi2.ppf([0.005, 0.995], 120) / 40
    assert np.all((low < mean) & (mean < high))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.05)


def test_a_horizon_that_holds_all_measurements_gives_the_trajectory_of_least_cost():
    """Against a general solver on the cost as it is written, with nothing linearised."""
    samples = 30
    measured, inputs, _ = drawn(TUNING, 5, samples)
    ours = estimator_class("mhe")(PULL, dataclasses.replace(TUNING, horizon=100), period=PERIOD)
    first = ours.update(0.0, measured[:1], inputs[:1])
    for k in range(1, samples):
        estimate = ours.update(k * PERIOD, measured[k : k + 1], inputs[k : k + 1])
    spread = np.sqrt(np.diag(first.covariance)[:3])
    steps = np.sqrt(PERIOD) * np.array([*TUNING.process_noise, *TUNING.disturbance_noise])

    def residuals(unknown):
        z = unknown.reshape(samples, 3)
        rows = [(z[0] - [measured[0], 0.0, 0.0]) / spread]
        for k in range(1, samples):
            rows.append((z[k] - advanced(z[k - 1], inputs[k])) / steps)
            rows.append(np.array([(measured[k] - z[k, 0]) / TUNING.measurement_noise[0]]))
        return np.concatenate(rows)

    solution = least_squares(residuals, np.zeros(3 * samples), x_scale=np.tile(spread, samples), xtol=1e-12)
    best = solution.x.reshape(samples, 3)[-1]
    deviations = np.sqrt(np.diag(estimate.covariance)[:3])
    assert np.all(np.abs(np.array([*estimate.state, *estimate.disturbance]) - best) < 0.05 * deviations)
    # And the covariance is the inverse of the curvature.
    curvature = np.linalg.inv(solution.jac.T @ solution.jac)[-3:, -3:]
    np.testing.assert_allclose(estimate.covariance[:3, :3], curvature, rtol=0.05, atol=0.02 * curvature.max())


def test_the_triangle_is_a_square_root():
    rows = np.random.default_rng(0).normal(size=(13, 4))
    rows[:, 2] = 0.0
    root = np.empty((4, 4))
    triangle_of(rows.copy(), root)
    np.testing.assert_allclose(root @ root.T, rows.T @ rows, atol=1e-12)
    assert np.all(np.triu(root, 1) == 0.0)


def test_equations_are_solved_where_something_has_no_variance():
    """Nothing of its own: the third entry has none at all, the fifth is the sum of the first two."""
    half = np.random.default_rng(1).normal(size=(6, 5))
    half[:, 2] = 0.0
    half[:, 4] = half[:, 0] + half[:, 1]
    root, x = np.empty((5, 5)), np.array([1.0, 2.0, 0.0, -1.0, 3.0])
    triangle_of(half.copy(), root)
    np.testing.assert_allclose(root @ root.T, half.T @ half, atol=1e-12)
    solve_triangular(root, x)
    solve_transposed(root, x)
    rest = [0, 1, 3]
    matrix = (half.T @ half)[np.ix_(rest, rest)]
    np.testing.assert_allclose(x[rest], np.linalg.solve(matrix, [1.0, 2.0, -1.0]))
    assert x[2] == x[4] == 0.0


@pytest.mark.parametrize(("samples", "degrees"), [(10, 1), (50, 2), (200, 1), (2000, 1), (40, 5)])
def test_a_band_is_the_chi_square_one(samples, degrees):
    exact = chi2.ppf([0.025, 0.975], samples * degrees) / samples
    np.testing.assert_allclose(band(samples, degrees), exact, rtol=1e-2 if samples * degrees < 100 else 1e-3)
