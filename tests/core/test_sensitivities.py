"""Derivatives that a simulation carries along, against differences of simulations."""

import numpy as np
import pytest
from hybrid_sysid_ros.core.forward_sensitivity import forward_sensitivity
from tests.test_equations import structure
from tests.test_linearisation import polynomial

from hybrid_sysid_ros.core import kernels
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.problem import Problem
from hybrid_sysid_ros.models import Sampling
from tests.one_joint import Linear

STEP, EVERY, SAMPLES = 0.005, 10, 60


def drive(seed=0, steps=EVERY * SAMPLES):
    return np.repeat(np.random.default_rng(seed).uniform(-6.0, 8.0, steps // 25), 25)[:, None]


def simulated(system, state, inputs):
    out = np.empty((SAMPLES, len(system.states)))
    starts = np.array([[0, 0, SAMPLES, 0]])
    given = (state[None], inputs, system.delay / STEP, EVERY, system.named, system.weights, STEP)
    kernels(system).windows(starts, *given, out)
    return out[:, list(system.outputs)]


def carried(system, names, state, inputs):
    sensitivity = forward_sensitivity(system, names)
    out = np.empty((SAMPLES, len(system.outputs), sensitivity.lanes))
    starts = np.array([[0, 0, SAMPLES, 0]])
    given = (state[None], inputs, system.delay / STEP, EVERY, system.named, system.weights, STEP)
    sensitivity.windows(starts, *given, sensitivity.workspace, out)
    return out


def test_on_a_linear_beam_they_are_the_powers_of_its_matrix():
    """Closed form: the state's derivative by the initial state after k steps is A^k, by an offset the sum of A^j b."""
    system = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
    half = 0.5 * STEP * system.damping
    velocity = np.array([-STEP * system.stiffness, 1.0 - half]) / (1.0 + half)
    a = np.array([np.array([1.0, 0.0]) + STEP * velocity, velocity])
    b = STEP * system.gain / (1.0 + half) * np.array([STEP, 1.0])
    out = carried(system, (), np.array([0.02, 0.3]), drive())[:, 0]
    forced, power = np.zeros(2), np.eye(2)
    for sample in range(1, SAMPLES):
        for _ in range(EVERY):
            forced, power = a @ forced + b, a @ power
        np.testing.assert_allclose(out[sample, 1:4], [*power[0], forced[0]], rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("name", ["linear", "stribeck", "dahl", "lugre", "gray", "hybrid", "black_box"])
def test_they_are_what_simulations_differ_by(name):
    """Of every parameter, the input's delay among them. Differences over a tenth of the step agree with them where no
    corner of friction lies between.
    """
    system = structure(name)
    names = tuple(item.name for item in system.parameters if not item.fixed)
    state, inputs = np.append([0.01, 0.2], np.zeros(len(system.states) - 2)), drive()
    out = carried(system, names, state, inputs)[:, 0]
    np.testing.assert_allclose(out[:, 0], simulated(system, state, inputs)[:, 0], atol=1e-12)
    known = [item.name for item in system.parameters]
    for lane, free in enumerate(names, start=1):
        values, item = system.values, system.parameters[known.index(free)]
        h = 1e-6 * max(abs(values[known.index(free)]), 1e-3)
        if not item.low + h < values[known.index(free)] < item.high - h:
            continue
        sides = []
        for side in (h, -h):
            moved = values.copy()
            moved[known.index(free)] += side
            sides.append(simulated(system.with_values(moved), state, inputs)[:, 0])
        expected = (sides[0] - sides[1]) / (2 * h)
        np.testing.assert_allclose(out[:, lane], expected, rtol=1e-3, atol=1e-4 * np.max(np.abs(expected)) + 1e-9)


def test_a_polynomial_has_no_parameters_but_initial_states():
    system = polynomial()
    state, inputs = np.array([0.02, -0.01, 1.0]), drive()
    out = carried(system, (), state, inputs)[:, 0]
    for lane in range(3):
        unit = 1e-6 * np.eye(3)[lane]
        expected = (simulated(system, state + unit, inputs) - simulated(system, state - unit, inputs))[:, 0] / 2e-6
        np.testing.assert_allclose(out[:, 1 + lane], expected, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("name", ["gray", "hybrid"])
@pytest.mark.parametrize("horizon", [20, None])
def test_the_jacobian_of_a_fit_is_what_its_residuals_differ_by(linear_records, name, horizon):
    """With initial states and biases of every record, whose columns reach into no other record."""
    system = structure(name)
    experiments = [prepare(record, system, Sampling()) for record in linear_records]
    problem = Problem(system, experiments, bias=0.1)
    random = np.random.default_rng(2)
    lower, upper = problem.bounds
    point = np.clip(problem.start + 0.02 * random.normal(size=len(problem.start)), lower, upper)
    residuals = problem.residuals(horizon)
    found = problem.jacobian(horizon, residuals, map)(point)
    for column in range(len(point)):
        unit = np.zeros(len(point))
        unit[column] = 1e-6
        expected = (residuals(point + unit) - residuals(point - unit)) / 2e-6
        off = np.linalg.norm(found[:, column] - expected) / np.linalg.norm(expected)
        assert off < 0.02, problem.names[column] if column < problem.shared else column
