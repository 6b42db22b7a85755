"""Networks inside a law: in registers or loops, they are what they are written as, with their derivatives."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import casadi
import numpy as np
import pytest

from benchmarks.network_plant import WEIGHTS, NetworkPlant, layers
from benchmarks.perceptron import Perceptron
from hybrid_sysid_ros.core import Softsign, System, one_step, step_with_jacobian
from hybrid_sysid_ros.core.blocks import Block
from hybrid_sysid_ros.core.steppers import Sampled
from hybrid_sysid_ros.core.symbolic import symbolic_output, symbolic_step
from hybrid_sysid_ros.support.errors import UserError
from tests.structures import BLOCKS as FURTHER_BLOCKS


@dataclass(frozen=True, kw_only=True)
class Given(System):
    """The features of a block are its inputs, and its outputs those of the system."""

    states = ("x [1]",)
    stepper = Sampled()
    blocks: tuple[Block, ...]
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self):
        features, outputs = self.blocks[0].features, self.blocks[-1].outputs
        object.__setattr__(self, "inputs", tuple(f"z{i} [1]" for i in range(features)))
        object.__setattr__(self, "outputs", tuple(f"y{i} [1]" for i in range(outputs)))

    @property
    def weights(self):
        return self.numbers

    def with_weights(self, weights):
        return Given(blocks=self.blocks, numbers=weights)

    def law(self, x, u):
        return x

    def output(self, x, u):
        values = u
        for block in self.blocks:
            values = block(values)
        return values


def through(block, weights, z):
    """Outputs, and derivatives by features and weights."""
    out, jacobian = step_with_jacobian(
        Given(blocks=(block,), numbers=weights), [0.0], z, step=1.0, output=True, learn=True
    )
    return out, jacobian[:, 1 : 1 + len(z)], jacobian[:, 1 + len(z) :]


def moved(function, point, h=1e-6):
    """Central differences (outputs, point)."""
    return np.transpose([(function(point + e) - function(point - e)) / (2 * h) for e in h * np.eye(len(point))])


def by_hand(weights, z):
    """A network as it is written: W tanh(...) + b."""
    *hidden, (matrix, bias) = weights
    for rows, biases in hidden:
        z = np.tanh(rows @ z + biases)
    return matrix @ z + bias


@pytest.mark.parametrize("widths", [(3, 32, 32, 1), (2, 5, 1), (4, 8, 16, 24, 2), (1, 40, 1)])
def test_a_perceptron_in_registers_is_the_one_that_is_written(widths):
    random = np.random.default_rng(0)
    weights = [(random.normal(size=(b, a)), random.normal(size=b)) for a, b in pairwise(widths)]
    block = Perceptron(widths=widths)
    packed = block.packed(weights)
    assert len(packed) == block.size
    for _ in range(20):
        z = 3.0 * random.normal(size=widths[0])
        out, by_features, _ = through(block, packed, z)
        np.testing.assert_allclose(out, by_hand(weights, z), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(by_features, moved(lambda z: by_hand(weights, z), z), rtol=1e-5, atol=1e-7)


def test_tanh_in_registers_is_that_of_the_library():
    """One unit without bias: y = tanh(z)."""
    block = Perceptron(widths=(1, 1, 1))
    packed = block.packed([(np.ones((1, 1)), np.zeros(1)), (np.ones((1, 1)), np.zeros(1))])
    for z in [0.0, -0.0, 1e-300, 1e-9, 0.3, -0.7, 5.0, -18.9, 19.5, 40.0, -1e300]:
        assert through(block, packed, [z])[0][0] == pytest.approx(np.tanh(z), rel=1e-9, abs=5e-16)
    assert np.isnan(through(block, packed, [np.nan])[0][0])


def softsigns(block, weights, z):
    rows = weights.reshape(block.units, -1)
    s = rows[:, : block.features] @ z + rows[:, block.features]
    return rows[:, block.features + 1 :].T @ (s / (1 + np.abs(s)))


LEARNT = {
    "softsign": (Softsign(features=3, units=4), softsigns),
    "softsigns of two outputs": (Softsign(features=2, units=5, outputs=2), softsigns),
}


@pytest.mark.parametrize("name", LEARNT)
def test_what_a_fit_learns_has_slopes_by_features_and_weights(name):
    check_slopes(*LEARNT[name])


def check_slopes(block, written, atol=1e-14):
    """Of a block against the same written by hand in numpy."""
    random = np.random.default_rng(1)
    for _ in range(20):
        weights, z = random.normal(size=block.size), random.normal(size=block.features)
        out, by_features, by_weights = through(block, weights, z)
        np.testing.assert_allclose(out, written(block, weights, z), rtol=1e-13, atol=atol)
        np.testing.assert_allclose(by_features, moved(lambda z: written(block, weights, z), z), rtol=1e-6, atol=1e-7)  # noqa: B023
        np.testing.assert_allclose(by_weights, moved(lambda w: written(block, w, z), weights), rtol=1e-6, atol=1e-7)  # noqa: B023


BLOCKS: dict[str, Any] = {
    **{name: block for name, (block, _) in LEARNT.items()},
    "perceptron": Perceptron(widths=(3, 7, 9, 2)),
    **{name: block for name, (block, _) in FURTHER_BLOCKS.items()},
}


@pytest.mark.parametrize("name", BLOCKS)
def test_every_block_is_the_one_that_is_exported(name):
    block = BLOCKS[name]
    random = np.random.default_rng(2)
    weights = random.normal(size=block.size)
    if name == "perceptron":
        weights = block.packed([(random.normal(size=(b, a)), random.normal(size=b)) for a, b in pairwise(block.widths)])
    exported = symbolic_output(Given(blocks=(block,), numbers=weights))
    z = casadi.SX.sym("z", block.features)
    jacobian = casadi.Function("j", [z], [casadi.jacobian(exported(0.0, z), z)])
    for _ in range(10):
        point = random.normal(size=block.features)
        out, by_features, _ = through(block, weights, point)
        np.testing.assert_allclose(out, np.array(exported(0.0, point)).ravel(), rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(by_features, np.array(jacobian(point)), rtol=1e-11, atol=1e-12)


def test_a_block_may_read_what_another_gives_and_each_has_its_own_weights():
    first, second = Softsign(features=2, units=3, outputs=2), Softsign(features=2, units=3, outputs=2, at=15)
    random = np.random.default_rng(3)
    weights, z = random.normal(size=30), random.normal(size=2)

    def written(z, weights):
        return softsigns(second, weights[15:], softsigns(first, weights[:15], z))

    system = Given(blocks=(first, second), numbers=weights)
    out, jacobian = step_with_jacobian(system, [0.0], z, step=1.0, output=True, learn=True)
    np.testing.assert_allclose(out, written(z, weights), rtol=1e-13)
    np.testing.assert_allclose(jacobian[:, 1:3], moved(lambda z: written(z, weights), z), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(jacobian[:, 3:], moved(lambda w: written(z, w), weights), rtol=1e-6, atol=1e-8)


def test_perceptrons_behind_each_other_have_their_own_weights():
    first = Perceptron(widths=(2, 4, 3))
    second = Perceptron(widths=(3, 8, 1), at=first.size)
    random = np.random.default_rng(4)
    parts = [
        [(random.normal(size=(b, a)), random.normal(size=b)) for a, b in pairwise(block.widths)]
        for block in (first, second)
    ]
    weights = np.concatenate([first.packed(parts[0]), second.packed(parts[1])])
    z = random.normal(size=2)
    out, _ = step_with_jacobian(Given(blocks=(first, second), numbers=weights), [0.0], z, step=1.0, output=True)
    np.testing.assert_allclose(out, by_hand(parts[1], by_hand(parts[0], z)), rtol=1e-12)


def test_the_reference_network_is_drawn_as_it_is_stated():
    """One step of the plant of the reference problem, by scipy's matrices and in CasADi."""
    plant, x, u, h = NetworkPlant(), np.array([0.5, -2.0]), np.array([1.0]), 1e-3

    def rates(x):
        network = by_hand(layers(), np.array([x[0], x[1] / 10, u[0] / 10]))[0]
        return np.array([x[1], 30.0 * u[0] - 8.0 * x[1] - 2.0 * x[0] + 5.0 * network])

    k1 = rates(x)
    k2 = rates(x + h / 2 * k1)
    k3 = rates(x + h / 2 * k2)
    k4 = rates(x + h * k3)
    expected = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    np.testing.assert_allclose(one_step(plant, x, u, step=h), expected, rtol=1e-12)
    np.testing.assert_allclose(np.array(symbolic_step(plant, step=h)(x, u)).ravel(), expected, rtol=1e-12)
    assert len(WEIGHTS) == len(plant.weights)


def test_layers_that_do_not_fit_are_refused():
    with pytest.raises(UserError, match="a layer of 4 units is followed by one for 5"):
        Perceptron.of([(np.zeros((4, 3)), np.zeros(4)), (np.zeros((1, 5)), np.zeros(1))])
    with pytest.raises(UserError, match=r"biases of shape \(3,\)"):
        Perceptron.of([(np.zeros((4, 3)), np.zeros(3)), (np.zeros((1, 4)), np.zeros(1))])
    with pytest.raises(UserError, match="each above 0"):
        Perceptron(widths=(3, 0, 1))
