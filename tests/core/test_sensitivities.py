"""Derivatives that a simulation carries along, against closed forms and differences of simulations."""

import numpy as np
import pytest

from hybrid_sysid_ros.core import Sensitivities, rollouts
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.problem import FitProblem
from hybrid_sysid_ros.models import Sampling
from tests.one_joint import Linear
from tests.structures import FURTHER, SYSTEMS, TwoTanks, structure

STEP, EVERY, SAMPLES = 0.005, 10, 60


def drive(seed=0, steps=EVERY * SAMPLES):
    return np.repeat(np.random.default_rng(seed).uniform(-6.0, 8.0, steps // 25), 25)[:, None]


def simulated(system, state, inputs):
    """Outputs (samples, outputs)."""
    starts = np.array([[0, 0, SAMPLES, 0]])
    return rollouts(system, starts, state[None], inputs, step=STEP, every=EVERY)[1]


def carried(system, state, inputs):
    """Derivatives (samples, outputs, columns) by parameters, weights and initial states."""
    sensitivities = Sensitivities(system)
    out = np.empty((SAMPLES, len(system.outputs), sensitivities.count))
    starts = np.array([[0, 0, SAMPLES, 0]])
    sensitivities.rollouts(system, starts, state[None], inputs, step=STEP, every=EVERY, out=out)
    return out


def difference(system, moved, h):
    """Central difference of outputs between ``moved`` (a number) -> (system, state, inputs) at +h and -h."""
    return (simulated(*moved(h)) - simulated(*moved(-h))) / (2 * h)


def test_on_a_linear_beam_they_are_the_powers_of_its_matrix():
    """Closed form: the state's derivative by the initial state after k steps is A^k."""
    system = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
    half = 0.5 * STEP * system.damping
    velocity = np.array([-STEP * system.stiffness, 1.0 - half]) / (1.0 + half)
    a = np.array([np.array([1.0, 0.0]) + STEP * velocity, velocity])
    out = carried(system, np.array([0.02, 0.3]), drive())[:, 0, -2:]
    power = np.eye(2)
    for sample in range(1, SAMPLES):
        for _ in range(EVERY):
            power = a @ power
        np.testing.assert_allclose(out[sample], power[0], rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize("name", ["linear", "stribeck", "dahl", "lugre", "gray", "hybrid", "black_box"])
def test_they_are_what_simulations_differ_by(name):
    """Of every parameter, the input's delay among them. Differences over a tenth of the step agree with them where no
    corner of friction lies between.
    """
    system = structure(name)
    names = [item.name for item in system.parameters if not item.fixed]
    state, inputs = np.append([0.01, 0.2], np.zeros(len(system.states) - 2)), drive()
    out = carried(system, state, inputs)
    for column, free in enumerate(names):
        value, item = system.named[free], next(item for item in system.parameters if item.name == free)
        h = 1e-6 * max(abs(value), 1e-3)
        if not item.low + h < value < item.high - h:
            continue

        def moved(change, free=free):
            values = {**system.named, free: system.named[free] + change}
            return system.with_values(list(values.values())), state, inputs

        expected = difference(system, moved, h)
        np.testing.assert_allclose(
            out[..., column], expected, rtol=1e-3, atol=1e-4 * np.max(np.abs(expected)) + 1e-9, err_msg=free
        )


LEARNT = [name for name in FURTHER if name not in ("recurrent", "residual")]
"""Those whose weights a fit learns all at once."""


@pytest.mark.parametrize("name", ["hybrid", "black_box", *LEARNT])
def test_weights_move_the_outputs_as_simulations_say(name):
    """Of a network of softsigns, of the coefficients of a polynomial, and of the premises of rules."""
    system = SYSTEMS[name]()
    state, inputs = np.append([0.01, 0.2], np.zeros(len(system.states) - 2)), drive()
    out = carried(system, state, inputs)
    first = sum(not item.fixed for item in system.parameters)
    for k in range(len(system.weights)):

        def moved(change, k=k):
            return system.with_weights(system.weights + change * np.eye(len(system.weights))[k]), state, inputs

        expected = difference(system, moved, 1e-6)
        size = np.max(np.abs(expected))
        np.testing.assert_allclose(out[..., first + k], expected, rtol=1e-3, atol=1e-4 * size + 1e-9, err_msg=str(k))


def test_two_inputs_of_different_delays_and_an_output_that_is_no_state():
    """Every column of both outputs, with the delays, the direct part of the output."""
    system, state = TwoTanks(), np.array([0.4, 0.1])
    inputs = np.column_stack([drive(0)[:, 0], drive(1)[:, 0]])
    out = carried(system, state, inputs)
    assert out.shape == (SAMPLES, 2, 4 + 2)

    def moved(column, change):
        values, begin = system.values, state.copy()
        (values, begin)[column > 3][column - 4 * (column > 3)] += change
        return system.with_values(values), begin, inputs

    for column in range(6):
        expected = difference(system, lambda h, c=column: moved(c, h), 1e-6)
        np.testing.assert_allclose(out[..., column], expected, rtol=1e-6, atol=1e-7, err_msg=str(column))


@pytest.mark.parametrize("name", ["gray", "hybrid"])
@pytest.mark.parametrize("horizon", [20, None])
def test_the_jacobian_of_a_fit_is_what_its_residuals_differ_by(linear_records, name, horizon):
    """With initial states of every record, whose columns reach into no other record."""
    system = structure(name)
    experiments = [prepare(record, system, Sampling()) for record in linear_records]
    problem = FitProblem(system, experiments)
    random = np.random.default_rng(2)
    lower, upper = problem.bounds
    point = np.clip(problem.start + 0.02 * random.normal(size=len(problem.start)), lower, upper)
    residuals = problem.residuals(horizon)
    found = problem.jacobian(horizon, map)(point)
    for column in range(len(point)):
        unit = np.zeros(len(point))
        unit[column] = 1e-6
        expected = (residuals(point + unit) - residuals(point - unit)) / 2e-6
        off = np.linalg.norm(found[:, column] - expected) / np.linalg.norm(expected)
        assert off < 0.02, problem.names[column] if column < problem.shared else column
