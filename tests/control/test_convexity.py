"""What a symmetric matrix lacks to be positive semidefinite, and steps about a Hessian that is not."""

import numba
import numpy as np
import pytest

from hybrid_sysid_ros.control.mpc import eigenvalues

find_lack = numba.njit(eigenvalues.find_lack)


@pytest.mark.parametrize("size", [1, 2, 5, 8])
def test_what_a_matrix_lacks_is_its_negative_part(size):
    """With numpy's eigenvalues and vectors."""
    random = np.random.default_rng(size)
    for _ in range(20):
        matrix = random.normal(size=(size, size))
        matrix += matrix.T
        values, vectors = np.linalg.eigh(matrix)
        find_lack(matrix)
        np.testing.assert_allclose(matrix, (vectors * np.maximum(-values, 0.0)) @ vectors.T, atol=1e-6)


def test_a_matrix_that_is_positive_lacks_nothing():
    matrix = np.diag([2.0, 0.0, 1e-9])
    find_lack(matrix)
    assert not matrix.any()


def test_numbers_that_are_none_end():
    matrix = np.full((3, 3), np.nan)
    find_lack(matrix)
    assert matrix.shape == (3, 3)
