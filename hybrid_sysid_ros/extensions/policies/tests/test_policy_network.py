"""A policy's network in torch: the bounds it may pass, and its descent."""

import numpy as np
import pytest

from hybrid_sysid_ros.control.policy.training_settings import Settings


@pytest.fixture
def networks():
    """Imported late, as torch is: a quarter of the time in which all tests are collected."""
    return pytest.importorskip("hybrid_sysid_ros.extensions.policies.network", exc_type=ImportError)


def test_an_answer_beyond_the_bound_is_right_where_the_bound_is(networks):
    torch = pytest.importorskip("torch")
    targets = torch.tensor([1.0, 1.0, -1.0, 0.5])
    answers = torch.tensor([1.7, 0.6, -3.0, 0.7])
    np.testing.assert_allclose(networks.beyond_bounds(answers, targets), [0.0, -0.4, 0.0, 0.2], atol=1e-6)


def test_a_descent_finds_a_function_that_the_network_can_be(networks):
    """A network learns from samples of another one with as many units; the same seed learns the same."""
    torch = pytest.importorskip("torch")
    random = torch.Generator().manual_seed(6)
    inputs = torch.randn(2000, 3, generator=random)
    with torch.no_grad():
        targets = networks.new_network([3, 8, 2], seed=7)(inputs)

    def loss(network, rows):
        return torch.mean((network(inputs[rows]) - targets[rows]) ** 2)

    found = []
    for _ in range(2):
        network = networks.new_network([3, 8, 2], seed=8)
        settings = Settings(rate=1e-2, batch=100)
        networks.descend(network, loss, 2000, settings, 30, 0, lambda done, of: None)
        found.append(network(inputs).detach())
    assert torch.mean((found[0] - targets) ** 2) < 1e-3 * torch.var(targets)
    np.testing.assert_array_equal(found[0], found[1])
