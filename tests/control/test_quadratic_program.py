"""Quadratic programs in compiled code: the conditions of Karush, Kuhn and Tucker hold."""

import numba
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hybrid_sysid_ros.control.mpc import quadratic_program as quadratic
from hybrid_sysid_ros.control.mpc.quadratic_program import BOUNDS, GRADIENT, MATRICES, STATES, quadratic_program

solve, keep_working_set = numba.njit(quadratic.solve), numba.njit(quadratic.keep_working_set)
ALL = MATRICES | GRADIENT | BOUNDS | STATES


def fill(program, random, rows):
    variables = len(program.gradient)
    factor = random.normal(size=(variables, variables))
    program.hessian[:] = factor @ factor.T + 0.1 * np.eye(variables)
    program.gradient[:] = 5.0 * random.normal(size=variables)
    program.rows[:] = random.normal(size=(rows, variables))
    program.lower[:], program.upper[:] = -0.3, 0.4


def stationarity(program):
    variables = len(program.gradient)
    price = program.multipliers[:variables] + program.rows.T @ program.multipliers[variables:]
    return program.hessian @ program.solution + program.gradient + price


def test_bounded_variables_are_those_of_bounded_least_squares():
    random = np.random.default_rng(0)
    program, _memory = quadratic_program(12, 0)
    for _ in range(20):
        fill(program, random, 0)
        assert solve(program, ALL)
        root = np.linalg.cholesky(program.hessian).T
        right = -np.linalg.solve(root.T, program.gradient)
        expected = lsq_linear(root, right, bounds=(-0.3, 0.4), tol=1e-14, method="bvls").x
        np.testing.assert_allclose(program.solution, expected, atol=1e-7)


@pytest.mark.parametrize("warm", [False, True])
def test_with_rows_the_optimality_conditions_hold_from_any_start(warm):
    random = np.random.default_rng(1)
    program, _memory = quadratic_program(10, 8)
    solved = 0
    for _ in range(30):
        fill(program, random, 8)
        if not warm:
            program.states[:] = 0
        solved += solve(program, ALL)
        keep_working_set(program)
        values = np.concatenate([program.solution, program.rows @ program.solution])
        np.testing.assert_allclose(stationarity(program), 0.0, atol=1e-9)
        assert np.all(values <= program.upper + 1e-7)
        assert np.all(values >= program.lower - 1e-7)
        np.testing.assert_allclose(
            program.multipliers * (values - program.upper) * (program.multipliers > 0), 0, atol=1e-7
        )
        np.testing.assert_allclose(
            program.multipliers * (values - program.lower) * (program.multipliers < 0), 0, atol=1e-7
        )
    assert solved == 30


def test_a_soft_row_is_violated_at_its_price():
    """min x^2 / 2 - 3 x, x <= 1 softly at 0.5 s + 2 s^2: 1 + s - 3 + 0.5 + 4 s = 0, so s = 0.3."""
    program, _memory = quadratic_program(
        1, 1, soft_rows=np.array([True]), soft_linear=np.array([0.5]), soft_quadratic=np.array([2.0])
    )
    program.hessian[:], program.gradient[:], program.rows[:] = 1.0, -3.0, 1.0
    program.lower[:], program.upper[:] = [-10.0, -1.0], [10.0, 1.0]
    assert solve(program, ALL)
    assert program.solution[0] == pytest.approx(1.3, abs=1e-9)


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_search_that_begins_at_the_solution_ends_there_at_once(share):
    """min |x - 2|^2 / 2, x <= 1 softly: kept where a distance costs more than the multiplier of 1, else violated."""
    many = 6
    program, _memory = quadratic_program(
        many, many, soft_rows=np.ones(many, bool), soft_linear=np.full(many, share), soft_quadratic=np.ones(many)
    )
    program.gradient[:], program.rows[:] = -2.0, np.eye(many)
    program.lower[:], program.upper[:many], program.upper[many:] = -10.0, 10.0, 1.0
    for _ in range(2):
        assert solve(program, ALL)
        keep_working_set(program)
    np.testing.assert_allclose(program.solution, 1.0 + max(1.0 - share, 0.0) / 3.0, atol=1e-9)
    assert quadratic._Result.from_buffer(program.result.data).iterations == 1


def test_a_program_without_solution_is_reported():
    program, _memory = quadratic_program(1, 1)
    program.rows[:] = 1.0
    program.lower[:], program.upper[:] = [-1.0, 2.0], [1.0, 3.0]
    assert not solve(program, ALL)
    program.lower[1] = 0.5
    assert solve(program, ALL)
    assert program.solution[0] == pytest.approx(0.5)


def test_numbers_that_are_none_have_no_solution():
    program, _memory = quadratic_program(3, 0)
    program.gradient[:] = np.nan
    assert not solve(program, ALL) or not np.all(np.isfinite(program.solution))
    program.gradient[:] = 0.1
    assert solve(program, ALL)
    np.testing.assert_allclose(program.solution, -0.1)
