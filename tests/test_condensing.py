"""A least-squares problem in few rows, against the same one in many."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from hybrid_sysid_ros.identification.condensed_residuals import CondensedResiduals

ROWS, COLUMNS = 400, 7


def problem(seed=0):
    """Residuals that are not linear, with a prior on every number."""
    random = np.random.default_rng(seed)
    slopes, target = random.normal(size=(ROWS, COLUMNS)), random.normal(size=ROWS)

    def residuals(x):
        return np.concatenate([np.tanh(slopes @ x) - target, 0.3 * x])

    def jacobian(x):
        return np.concatenate([slopes * (1.0 - np.tanh(slopes @ x) ** 2)[:, None], 0.3 * np.eye(COLUMNS)])

    return residuals, jacobian


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_steps_depend_on_is_that_of_all_rows(seed):
    residuals, jacobian = problem(seed)
    few, x = CondensedResiduals(residuals, jacobian), np.random.default_rng(seed).normal(size=COLUMNS)
    f, slopes, short, small = residuals(x), jacobian(x), few.residuals(x), few.jacobian(x)
    assert small.shape == (COLUMNS + 1, COLUMNS)
    assert short @ short == pytest.approx(f @ f)
    np.testing.assert_allclose(small.T @ short, slopes.T @ f, rtol=1e-9)
    np.testing.assert_allclose(small.T @ small, slopes.T @ slopes, rtol=1e-9)


def test_the_optimiser_goes_the_same_way_within_bounds():
    residuals, jacobian = problem()
    few, begin = CondensedResiduals(residuals, jacobian), np.full(COLUMNS, 0.1)
    options = {"bounds": (-0.02, 0.5), "method": "trf", "ftol": 1e-10, "xtol": 1e-10}
    whole = least_squares(residuals, begin, jacobian, **options)
    short = least_squares(few.residuals, begin, few.jacobian, **options)
    assert (short.nfev, short.njev) == (whole.nfev, whole.njev)
    np.testing.assert_allclose(short.x, whole.x, atol=1e-7)
    assert np.any(whole.active_mask)
