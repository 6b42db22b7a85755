"""The polynomial as a block: it is what it is written as, with its derivatives."""

import numpy as np

from hybrid_sysid_ros.extensions.narx.tests.systems import BLOCKS, polynomial
from tests.core.test_networks import check_slopes
from tests.core.test_sensitivities import carried, difference, drive


def monomials(block, weights, z):
    return np.array([sum(w * np.prod(np.power(z, term)) for w, term in zip(weights, block.exponents, strict=True))])


def test_its_slopes_are_those_of_the_monomials():
    check_slopes(BLOCKS["polynomial"][0], monomials)


def test_a_polynomials_initial_states_are_all_of_its_lags():
    system = polynomial()
    state, inputs = np.array([0.02, -0.01, 1.0]), drive()
    out = carried(system, state, inputs)[:, 0, len(system.weights) :]
    for column in range(3):
        expected = difference(system, lambda h, i=column: (system, state + h * np.eye(3)[i], inputs), 1e-6)[:, 0]
        np.testing.assert_allclose(out[:, column], expected, rtol=1e-4, atol=1e-7)
