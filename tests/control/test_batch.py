"""Many calls of the exact MPC in compiled code are those of one controller, whatever the threads."""

import subprocess
import sys

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.extensions.shared import drawn_scenarios, scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import Spread
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError
from tests.control.beam_problem import PROBLEM

SPREAD = Spread(amplitude=(0.04,), disturbance=(0.3,), push=(0.01, 0.1), parameters=0.1)


@pytest.fixture(scope="module")
def mpc(rig):
    return ExactMpc(rig.system, PROBLEM)


@pytest.fixture(scope="module")
def drawn(rig):
    """Four loops that begin anew once, with errors of what the controller gets."""
    problem, spread, random = PROBLEM.sized(rig.system), SPREAD.sized(rig.system), np.random.default_rng(0)
    found = []
    for _ in range(4):
        wanted = 0.04 * np.sin(random.uniform(1.0, 9.0) * 0.02 * np.arange(40 + problem.horizon - 1))[:, None]
        begins = np.isin(np.arange(40), (0, 25))
        scenario = drawn_scenarios.drawn(random, rig.system, problem, spread, wanted, begins)
        errors = random.normal(size=(40, 2)) * np.array([1e-4, 1e-3])
        found.append(scenario._replace(state_errors=errors, input_errors=0.3 * random.normal(size=(40, 1))))
    return found


@pytest.fixture(scope="module")
def loops(mpc, drawn):
    return list(scenarios.run_many(mpc, drawn, threads=2))


@pytest.mark.slow
def test_a_compiled_loop_is_the_loop_of_a_controller(mpc, drawn, loops):
    def control(k, asked):
        if drawn[0].begins[k]:
            mpc.reset()
        plan = mpc.control(*asked)
        mpc.prepare(PROBLEM.period)
        return plan.input

    by_hand, (compiled, answers) = scenarios.run(drawn[0], mpc.problem, control), loops[0]
    for one, other in zip(by_hand, compiled, strict=True):
        np.testing.assert_array_equal(one, other)
    assert answers.solved.all()
    assert answers.residuals.max() <= 1e-6


def test_no_digit_depends_on_threads_or_order(mpc, drawn, loops):
    alone = list(scenarios.run_many(mpc, drawn[::-1], threads=1))[::-1]
    for (one, _), (other, _) in zip(loops, alone, strict=True):
        np.testing.assert_array_equal(one.states, other.states)
    rows = np.concatenate([loop.asked for loop, _ in loops])
    order = np.random.default_rng(0).permutation(len(rows))
    one, three, mixed = mpc.solve_many(rows, threads=1), mpc.solve_many(rows, threads=3), mpc.solve_many(rows[order])
    assert one.solved.all()
    np.testing.assert_array_equal(one.inputs, three.inputs)
    np.testing.assert_array_equal(one.inputs[order], mixed.inputs)
    near = mpc.solve_many(rows, one.inputs)
    assert near.iterations.mean() < one.iterations.mean()
    assert np.median(np.abs(near.inputs - one.inputs)) < 1e-6


def test_a_row_that_is_no_number_is_answered_within_the_bounds_and_disturbs_no_other(mpc, loops):
    rows = loops[0][0].asked[:5].copy()
    sound = mpc.solve_many(rows)
    rows[2, 0], rows[2, 3] = np.nan, 4.0
    found = mpc.solve_many(rows, threads=1)
    assert not found.solved[2]
    assert found.iterations[2] == 0
    np.testing.assert_array_equal(found.inputs[2], 4.0)
    for row in (0, 1, 3, 4):
        np.testing.assert_array_equal(found.inputs[row], sound.inputs[row])


def test_what_does_not_fit_is_refused(mpc, drawn):
    with pytest.raises(UserError, match=r"instances have shape \(3, 5\); they need \(3, 14\)"):
        mpc.solve_many(np.zeros((3, 5)))
    with pytest.raises(UserError, match=r"instances have shape \(14,\); they need \(1, 14\)"):
        mpc.solve_many(np.zeros(14))
    with pytest.raises(UserError, match="are arrays of numbers"):
        mpc.solve_many("x")
    with pytest.raises(UserError, match=r"starts have shape \(2, 10, 1\); they need \(3, 10, 1\)"):
        mpc.solve_many(np.zeros((3, 14)), np.zeros((2, 10, 1)))
    with pytest.raises(UserError, match="threads is -1"):
        mpc.solve_many(np.zeros((3, 14)), threads=-1)
    other = drawn[0]._replace(plant=load("wheel_motor").system)
    with pytest.raises(UserError, match="has other states, inputs or outputs than the MPC"):
        list(scenarios.run_many(mpc, [other]))


ENDING = """
import threading, time
import numpy as np
from hybrid_sysid_ros.control import ExactMpc
from tests.control.beam_problem import PROBLEM
from hybrid_sysid_ros.rigs.rig import load
mpc = ExactMpc(load("cam_beam").system, PROBLEM)
states = np.random.default_rng(0).normal(size=(200_000, 2)) * [0.02, 0.1]
rows = np.hstack([states, np.zeros((len(states), 2 + PROBLEM.horizon))])
mpc.solve_sequence(rows[:1], np.ones(1, bool))
threading.Thread(target=mpc.solve_sequence, args=(rows, np.ones(len(rows), bool)), daemon=True).start()
time.sleep(0.1)
"""


@pytest.mark.slow
def test_a_process_may_end_while_a_thread_still_solves():
    for _ in range(2):
        subprocess.run([sys.executable, "-c", ENDING], check=True, timeout=120)
