"""Derivatives of the exact MPC's answers: those of the closed form, and differences of solutions."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc, Problem, Status
from tests.control import two_inputs
from tests.one_joint import Linear

LINEAR = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)
PROBLEM = Problem(
    horizon=6,
    period=0.05,
    substeps=8,
    output_weights=(100.0,),
    rate_weights=(1.0,),
    input_low=(-10.0,),
    input_high=(10.0,),
    output_scales=(0.0227,),
    smoothing=0.005,
    max_iterations=200,
)


def asked(random, size=1.0):
    state = size * np.array([0.05, 0.3]) * random.normal(size=2)
    preview = state[0] + size * 0.03 * np.cumsum(random.normal(size=PROBLEM.horizon)) / 3
    return np.concatenate([state, 0.3 * random.normal(size=1), np.clip(3 * random.normal(size=1), -9, 9), preview])


def answered(mpc, p):
    return mpc.control(p[:2], p[2:3], p[3:4], p[4:, None])


def differences(mpc, p, step):
    """Derivatives of the first input by differences of solutions."""
    slopes = np.empty(len(p))
    for j in range(len(p)):
        sides = []
        for side in (step[j], -step[j]):
            q = p.copy()
            q[j] += side
            plan = answered(mpc, q)
            if plan.status is not Status.SOLVED:
                return None
            sides.append(plan.input[0])
        slopes[j] = (sides[0] - sides[1]) / (2 * step[j])
    return slopes


STEPS = np.array([1e-4, 1e-3, 1e-2, 1e-2, *[1e-4] * PROBLEM.horizon])


def test_of_a_linear_problem_they_are_its_feedback():
    """The answer is linear where no bound is active, so differences of any size are its derivatives."""
    mpc = ExactMpc(LINEAR, dataclasses.replace(PROBLEM, input_low=(-1e3,), input_high=(1e3,)), tolerance=1e-10)
    random = np.random.default_rng(0)
    for _ in range(5):
        p = asked(random)
        assert answered(mpc, p).status is Status.SOLVED
        (found,) = mpc.sensitivity()
        np.testing.assert_allclose(found, differences(mpc, p, STEPS), rtol=1e-4, atol=1e-5 * np.max(np.abs(found)))


OPTIONS: dict[str, dict[str, Any]] = {
    "bounds": {"input_low": (-4.0,), "input_high": (3.0,)},
    "rate limit": {"rate_limits": (1.5,)},
    "soft state bounds": {
        "state_low": (-0.05, -0.6),
        "state_high": (0.05, 0.6),
        "soft_quadratic": (1e4 / 0.0227**2,),
    },
    "priced state bounds": {
        "state_low": (-0.05, -0.6),
        "state_high": (0.05, 0.6),
        "soft_linear": (50.0 / 0.0227,),
        "soft_quadratic": (1e4 / 0.0227**2,),
    },
    "input weight": {"input_weights": (0.1,)},
}


@pytest.mark.parametrize("option", OPTIONS)
def test_on_the_beam_they_are_what_solutions_differ_by(rig, option):
    """Where neighbouring solutions keep the same active constraints; at their borders a derivative has two sides."""
    problem = dataclasses.replace(PROBLEM, **OPTIONS[option])
    mpc = ExactMpc(rig.system, problem, tolerance=1e-9)
    random = np.random.default_rng(1)
    alike = bounded = compared = 0
    for _ in range(60):
        p = asked(random, size=1.5)
        plan = answered(mpc, p)
        if plan.status is not Status.SOLVED:
            continue
        (found,) = mpc.sensitivity()
        coarse, fine = differences(mpc, p, STEPS * 1e-2), differences(mpc, p, STEPS * 1e-3)
        if coarse is None or fine is None or not np.allclose(coarse, fine, rtol=0.02, atol=0.01 * np.max(np.abs(fine))):
            continue
        compared += 1
        bounded += bool(np.any((plan.inputs == problem.input_low) | (plan.inputs == problem.input_high)))
        alike += bool(np.allclose(found, fine, rtol=0.03, atol=0.01 * np.max(np.abs(fine)) + 1e-6))
    assert compared > 15
    assert alike >= 0.9 * compared
    assert bounded > 5 or option != "bounds"


def test_at_a_bound_the_first_input_does_not_move():
    mpc = ExactMpc(LINEAR, PROBLEM)
    p = np.array([0.0, 0.0, 0.0, 9.5, *[0.5] * PROBLEM.horizon])
    plan = answered(mpc, p)
    assert plan.input[0] == pytest.approx(10.0)
    np.testing.assert_array_equal(mpc.sensitivity(), 0.0)


def test_taking_them_changes_no_later_answer(rig):
    random = np.random.default_rng(3)
    questions = [asked(random) for _ in range(10)]
    plain, other = ExactMpc(rig.system, PROBLEM), ExactMpc(rig.system, PROBLEM)
    for p in questions:
        first, second = answered(plain, p), answered(other, p)
        np.testing.assert_array_equal(first.inputs, second.inputs)
        other.sensitivity()
        plain.prepare(PROBLEM.period)
        other.prepare(PROBLEM.period)


@pytest.mark.parametrize("option", [{}, {"rate_limits": (0.3, np.inf)}])
def test_of_two_inputs_they_are_what_solutions_differ_by(option):
    """On arms with friction and outputs that are no states, every column of [x, d, u_previous, q_1, ..., q_N]."""
    problem = dataclasses.replace(two_inputs.PROBLEM, **option)
    mpc = ExactMpc(two_inputs.Arms(), problem, tolerance=1e-9)

    def solved(p):
        plan = mpc.control(p[:4], p[4:6], p[6:8], p[8:].reshape(-1, 2))
        return plan.input if plan.status is Status.SOLVED else np.full(2, np.nan)

    alike = compared = 0
    for seed in range(12):
        state, d, previous, preview = two_inputs.instance(seed)
        previous = np.clip(previous, -1.4, 0.9)
        p = np.concatenate([state, d, previous, preview.ravel()])
        first = solved(p)
        found = mpc.sensitivity()
        assert found.shape == (2, 4 + 2 + 2 + 24)
        apart = []
        for step in (1e-4, 1e-5):
            sides = [(solved(p + step * row) - solved(p - step * row)) / (2 * step) for row in np.eye(len(p))]
            apart.append(np.array(sides).T)
        scale = np.max(np.abs(apart[1]))
        if not np.isfinite(first.sum() + scale) or not np.allclose(apart[0], apart[1], rtol=0.02, atol=0.01 * scale):
            continue
        compared += 1
        alike += bool(np.allclose(found, apart[1], rtol=0.03, atol=0.01 * scale + 1e-6))
    assert compared > 4
    assert alike >= 0.9 * compared
