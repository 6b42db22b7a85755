"""Compiled derivatives: those of CasADi, for every structure, operation and network."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import casadi
import numpy as np
import pytest
from hybrid_sysid_ros.core.casadi_form import symbolic, symbolic_step
from hybrid_sysid_ros.core.linearisation import linearisation, workspace
from tests.test_equations import MOTIONS, RANGE, structure

from benchmarks.network_plant import NETWORK, WEIGHTS, NetworkPlant, layers
from hybrid_sysid_ros.core import System, kernels
from hybrid_sysid_ros.core.perceptron import Perceptron, compiled, passes, unrolled
from hybrid_sysid_ros.models.narx import Narx
from hybrid_sysid_ros.models.recurrent import Recurrent
from hybrid_sysid_ros.support.errors import UserError

SUBSTEPS, STEP = 3, 0.005


def recurrent():
    system = Recurrent(units=5, position_scale=0.05, rate_scale=0.2, drive_scale=4.0)
    return system.with_weights(np.random.default_rng(0).normal(size=len(system.weights)))


def polynomial():
    """Compiled after one of more lags, with which it shares the step and not the size of its dual numbers."""
    lag = Narx(
        exponents=((1, 0, 0, 0, 0, 0, 0, 0, 0), (0, 0, 0, 0, 1, 0, 0, 0, 0)),
        coefficients=(0.9, 0.1),
        output_lags=4,
        input_lags=5,
        output_range=(-0.2, 0.2),
        input_range=(-10.0, 10.0),
    )
    linearisation(lag, smoothing=0.005)
    return Narx(
        exponents=((0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 1, 0), (2, 0, 0, 1), (0, 0, 1, 2)),
        coefficients=(0.1, 0.9, -0.2, 0.3, 0.1),
        output_lags=2,
        input_lags=2,
        output_range=(-0.2, 0.2),
        input_range=(-10.0, 10.0),
        output_scale=0.1,
        input_scale=5.0,
    )


EQUATIONS: dict[str, Callable[[], System]] = {
    **{name: partial(structure, name) for name in MOTIONS},
    "narx": polynomial,
    "recurrent": recurrent,
    "network": NetworkPlant,
}


CORNERLESS = ("dahl", "lugre", "narx", "recurrent", "network")
"""Their code is the same whatever corners of dry friction are rounded over."""


@pytest.mark.parametrize("name", CORNERLESS)
def test_only_dry_friction_has_corners(name):
    def refused(x, limit):
        raise AssertionError("a corner")

    system = EQUATIONS[name]()
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u", len(system.inputs))
    given = casadi.vertsplit(x), casadi.vertsplit(u), system.named, system.weights.tolist()
    system.advance(replace(symbolic(), saturate=refused))(*given, STEP, [None] * len(system.states))


@pytest.mark.parametrize(
    ("name", "smoothing"),
    [(name, smoothing) for name in EQUATIONS for smoothing in ((0.005,) if name in CORNERLESS else (0.0, 0.005))],
)
def test_the_jacobian_of_several_steps_is_that_of_the_casadi_form(name, smoothing):
    system = EQUATIONS[name]()
    states, inputs = len(system.states), len(system.inputs)
    step = symbolic_step(system, step=STEP, substeps=SUBSTEPS, smoothing=smoothing)
    x, u = casadi.SX.sym("x", states), casadi.SX.sym("u", inputs)
    following = step(x, u)
    expected = casadi.Function("j", [x, u], [following, casadi.jacobian(following, x), casadi.jacobian(following, u)])
    linearise, rows = linearisation(system, smoothing=smoothing), workspace(system)
    end, by_state, by_input = np.zeros(states), np.zeros((states, states)), np.zeros((states, inputs))
    random = np.random.default_rng(3)
    for _ in range(20):
        state = random.uniform(-1, 1, states) * np.append(RANGE[:2], np.full(states - 2, 0.005))
        drive = random.uniform(-1, 1, inputs) * RANGE[2]
        linearise(state, drive, system.named, system.weights, STEP, SUBSTEPS, rows, end, by_state, by_input)
        for found, wanted in zip((end, by_state, by_input), expected(state, drive), strict=True):
            np.testing.assert_allclose(found, np.array(wanted).reshape(found.shape), rtol=1e-9, atol=1e-12)


def test_without_rounding_the_linearised_step_is_the_simulated_one():
    system = structure("hybrid")
    linearise, rows = linearisation(system, smoothing=0.0), workspace(system)
    state, drive, end = np.array([0.02, -0.3]), np.array([4.0]), np.zeros(2)
    linearise(state, drive, system.named, system.weights, STEP, 1, rows, end, np.zeros((2, 2)), np.zeros((2, 1)))
    following = np.zeros(2)
    kernels(system).step(state, drive, system.named, system.weights, STEP, following)
    np.testing.assert_allclose(end, following, rtol=1e-13)


def by_hand(weights, z):
    """A network as it is written: W tanh(...) + b."""
    *hidden, (matrix, bias) = weights
    for rows, biases in hidden:
        z = np.tanh(rows @ z + biases)
    return matrix @ z + bias


@pytest.mark.parametrize("widths", [(3, 32, 32, 1), (2, 5, 1), (4, 8, 16, 24, 2), (1, 40, 1)])
def test_a_network_in_registers_is_the_one_that_is_written(widths):
    random = np.random.default_rng(0)
    weights = [(random.normal(size=(b, a)), random.normal(size=b)) for a, b in pairwise(widths)]
    network = Perceptron.of(weights)
    packed = network.packed(weights)
    assert len(packed) == network.size
    run, features = passes(network), widths[0]
    in_registers, written_out = compiled(network), unrolled(network, np.tanh)
    for _ in range(20):
        z = 3.0 * random.normal(size=features)
        values, slopes = np.zeros(run.values), np.zeros(features)
        values[:features] = z
        run.forward(packed, values)
        answers = [run.output(packed, values, k) for k in range(widths[-1])]
        np.testing.assert_allclose(answers, by_hand(weights, z), rtol=1e-12, atol=1e-12)
        for k in range(widths[-1]):
            run.gradient(packed, values, k, slopes)
            moved = [(by_hand(weights, z + e)[k] - by_hand(weights, z - e)[k]) / 2e-6 for e in 1e-6 * np.eye(features)]
            np.testing.assert_allclose(slopes, moved, rtol=1e-5, atol=1e-7)
        assert in_registers(tuple(z), packed) == answers[0]
        assert written_out(tuple(z), packed) == pytest.approx(answers[0], rel=1e-12)


def test_tanh_in_registers_is_that_of_the_library():
    """One unit without bias: y = tanh(z)."""
    weights = [(np.ones((1, 1)), np.zeros(1)), (np.ones((1, 1)), np.zeros(1))]
    network = Perceptron.of(weights)
    run = compiled(network)
    for z in [0.0, -0.0, 1e-300, 1e-9, 0.3, -0.7, 5.0, -18.9, 19.5, 40.0, -1e300]:
        assert run((float(z),), network.packed(weights)) == pytest.approx(np.tanh(z), rel=1e-9, abs=5e-16)
    assert np.isnan(run((np.nan,), network.packed(weights)))


def test_the_reference_network_is_drawn_as_it_is_stated():
    z = np.array([0.5, -0.2, 0.1])
    assert compiled(NETWORK)(tuple(z), WEIGHTS) == pytest.approx(by_hand(layers(), z)[0], rel=1e-12)


def test_layers_that_do_not_fit_are_refused():
    with pytest.raises(UserError, match="a layer of 4 units is followed by one for 5"):
        Perceptron.of([(np.zeros((4, 3)), np.zeros(4)), (np.zeros((1, 5)), np.zeros(1))])
    with pytest.raises(UserError, match=r"biases of shape \(3,\)"):
        Perceptron.of([(np.zeros((4, 3)), np.zeros(3)), (np.zeros((1, 4)), np.zeros(1))])
    with pytest.raises(UserError, match="each above 0"):
        Perceptron(widths=(3, 0, 1))
