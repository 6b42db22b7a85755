"""Inputs of different delays: the faster waits, and the loop is that of equal delays."""

from collections.abc import Sequence
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
import pytest

from hybrid_sysid_ros.control import Controller, ExactMpc, waiting_inputs
from hybrid_sysid_ros.control.waiting_inputs import WaitingInputs
from hybrid_sysid_ros.core import System, simulate
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from tests.control.two_inputs import PROBLEM, Carts

STEP = PROBLEM.period / PROBLEM.substeps


@dataclass(frozen=True, kw_only=True)
class Even(Carts):
    delays = {"first_force": 0.1, "second_force": 0.1}


@dataclass(frozen=True, kw_only=True)
class Uneven(Carts):
    delays = {"first_force": 0.1}


def moved(state: Array, inputs: Array) -> Array:
    return np.asarray(simulate(Carts(), state, inputs.repeat(PROBLEM.substeps, axis=0), step=STEP)[-1])


def driven(controller: Controller, system: System, lags: Sequence[int]) -> tuple[Array, Array]:
    """States and inputs sent in a loop whose inputs act so many periods later; what is not known yet is taken to hold,
    as an estimator does.
    """
    sent = [np.zeros(2)] * 2
    states = [np.array([0.3, -0.2, 0.0, 0.0])]
    longest = max(lags)
    for k in range(40):
        known = [[sent[min(k + i + 2 - lag, k + 1)][j] for j, lag in enumerate(lags)] for i in range(longest)]
        ahead = PROBLEM.period * (k + longest + np.arange(1, PROBLEM.horizon + 1))
        preview = np.column_stack([0.3 * np.sin(2.0 * ahead), 0.2 * np.cos(3.0 * ahead)])
        plan = controller.control(moved(states[-1], np.array(known)), np.array([0.1, -0.1]), sent[-1], preview)
        sent.append(plan.input)
        controller.prepare(PROBLEM.period)
        acting = np.array([sent[k + 2 - lag][j] for j, lag in enumerate(lags)])
        states.append(moved(states[-1], acting[None]))
    return np.array(states), np.array(sent)


def test_the_faster_input_waits_and_the_loop_is_that_of_equal_delays() -> None:
    even, given = driven(ExactMpc(Even(), PROBLEM, tolerance=1e-9), Even(), (2, 2))
    waiting = WaitingInputs(ExactMpc(Uneven(), PROBLEM, tolerance=1e-9), Uneven(), step=STEP)
    uneven, sent = driven(waiting, Uneven(), (2, 0))
    np.testing.assert_allclose(uneven, even, atol=1e-6)
    np.testing.assert_allclose(sent[4:, 0], given[4:, 0], atol=1e-5)
    np.testing.assert_allclose(sent[4:, 1], given[2:-2, 1], atol=1e-5)
    assert np.abs(np.diff(given[:, 1])).max() > 0.1
    assert repr(waiting).startswith("WaitingInputs(ExactMpc(Uneven: ")


def test_parts_of_other_sizes_are_refused_before_compiled_code_writes_to_them() -> None:
    controller = WaitingInputs(ExactMpc(Uneven(), PROBLEM), Uneven(), step=STEP)
    sound = [np.zeros(4), np.zeros(2), np.zeros(2), np.zeros((PROBLEM.horizon, 2))]
    with patch.object(waiting_inputs, "_add_effect") as compiled:
        for place in range(len(sound)):
            parts = [part[1:] if k == place else part for k, part in enumerate(sound)]
            with pytest.raises(UserError, match="it needs"):
                controller.control(*parts)
        compiled.assert_not_called()


def test_it_takes_the_problem_of_the_mpc_within_and_answers_many_at_once() -> None:
    mpc = ExactMpc(Uneven(), PROBLEM)
    waiting, preview = WaitingInputs(mpc, Uneven(), step=STEP), np.full((PROBLEM.horizon, 2), 0.5)
    rows = np.concatenate([np.full(4, 0.1), np.zeros(4), preview.ravel()])[None]
    waiting.check()
    assert waiting.problem == mpc.problem
    plan = mpc.control(np.full(4, 0.1), np.zeros(2), np.zeros(2), preview)
    np.testing.assert_array_equal(waiting.solve_many(rows, threads=1).inputs[0], plan.inputs)


def test_what_waits_is_forgotten_at_a_reset_and_never_sent_as_nan() -> None:
    controller = WaitingInputs(ExactMpc(Uneven(), PROBLEM), Uneven(), step=STEP)
    preview = np.full((PROBLEM.horizon, 2), 0.5)
    for state in (np.zeros(4), np.full(4, np.nan), np.zeros(4)):
        first = controller.control(state, np.zeros(2), np.zeros(2), preview)
        assert np.isfinite(first.input).all()
        controller.prepare(PROBLEM.period)
    assert abs(controller.control(np.zeros(4), np.zeros(2), np.zeros(2), preview).input[1]) > 0.0
    controller.reset()
    assert controller.control(np.zeros(4), np.zeros(2), np.zeros(2), preview).input[1] == 0.0
