"""The linear quadratic regulator: closed forms, an MPC without bounds and without end, and its bounds."""

import dataclasses

import numpy as np
import pytest

from benchmarks.linear_quadratic_regulator import LinearQuadraticRegulator
from hybrid_sysid_ros.control import ControlProblem, ExactMpc, Status
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.support.errors import UserError
from tests.control import two_inputs
from tests.control.beam_problem import PROBLEM
from tests.one_joint import Linear, narx

LINEAR = Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0)


def scalar(slope, gain, constant=0.0):
    """y+ = slope y + gain u + constant."""
    return narx(
        exponents=((1, 0), (0, 1), (0, 0)),
        coefficients=(slope, gain, constant),
        output_lags=1,
        input_lags=1,
        output_range=(-1e6, 1e6),
        input_range=(-1e6, 1e6),
        period=1.0,
    )


def scalar_problem(**changes):
    plain = {"horizon": 3, "period": 1.0, "substeps": 1, "smoothing": 0.0, "max_iterations": 50}
    weights = {"output_weights": (2.0,), "input_weights": (0.7,), "input_low": (-10.0,), "input_high": (10.0,)}
    return ControlProblem(**{**plain, **weights, **changes})


@pytest.mark.parametrize(("slope", "gain"), [(0.9, 0.3), (1.4, -2.0), (0.0, 1.0), (1.0, 0.1)])
def test_a_scalar_plant_has_the_gain_of_the_quadratic_formula(slope, gain):
    """g^2 p^2 + (r (1 - a^2) - q g^2) p - q r = 0, K = a g p / (r + g^2 p)."""
    q, r = 2.0, 0.7
    linear = r * (1 - slope**2) - q * gain**2
    p = (-linear + np.sqrt(linear**2 + 4 * gain**2 * q * r)) / (2 * gain**2)
    regulator = LinearQuadraticRegulator(scalar(slope, gain), scalar_problem())
    np.testing.assert_allclose(regulator.feedback[0, 0], slope * gain * p / (r + gain**2 * p), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(regulator.feedback[0, 1], 1.0)  # the input before has no say where changes cost nothing


def test_the_golden_ratio_regulates_an_integrator():
    """y+ = y + u with q = r = 1: p^2 - p - 1 = 0, so u = -(1 / phi) y."""
    problem = scalar_problem(output_weights=(1.0,), input_weights=(1.0,))
    regulator = LinearQuadraticRegulator(scalar(1.0, 1.0), problem)
    plan = regulator.control(np.array([1.0]), np.zeros(1), np.zeros(1), np.zeros((3, 1)))
    assert plan.input[0] == pytest.approx(-2.0 / (1.0 + np.sqrt(5.0)))
    assert plan.status is Status.FEEDBACK


def test_the_closed_loop_has_the_stable_roots_of_the_symmetric_root_locus():
    """R D(z) D(1/z) + Q N(z) N(1/z) = 0 for y = N/D w, w the change of the input (Kalman's identity)."""
    regulator = LinearQuadraticRegulator(LINEAR, PROBLEM)
    a, b = regulator.rest.transition, regulator.rest.gain[:, 0]
    denominator = np.polymul(np.poly(a), [1.0, -1.0])
    first = b[0]  # y = [1, 0] (z - a)^-1 b z / (z - 1) w
    second = a[0, 1] * b[1] - a[1, 1] * b[0]
    numerator = np.polymul([first, second], [1.0, 0.0])
    weight = PROBLEM.output_weights[0] / PROBLEM.output_scales[0] ** 2
    changes = PROBLEM.rate_weights[0] * np.convolve(denominator, denominator[::-1])
    errors = weight * np.polymul(np.convolve(numerator, numerator[::-1]), [1.0, 0.0])
    roots = np.roots(np.polyadd(changes, errors))
    stable = np.sort_complex(roots[np.abs(roots) < 1.0])
    through = np.block([[a, regulator.rest.gain], [np.zeros((1, 2)), np.ones((1, 1))]])
    closed = through - np.outer(np.append(b, 1.0), regulator.feedback[0])
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(closed)), stable, atol=1e-7)


@pytest.mark.parametrize("preview", [True, False])
def test_it_is_the_first_input_of_an_mpc_without_bounds_and_without_end(preview):
    """On a linear model, whatever the reference; the MPC solves its program, the regulator a Riccati equation."""
    free = dataclasses.replace(PROBLEM, input_low=(-1e6,), input_high=(1e6,))
    regulator = LinearQuadraticRegulator(LINEAR, free, preview=preview)
    mpc = ExactMpc(LINEAR, dataclasses.replace(free, horizon=150), tolerance=1e-9)
    random = np.random.default_rng(0)
    for _ in range(10):
        state, d = random.normal(size=2) * [0.05, 0.3], random.normal(size=1)
        previous, wanted = 3.0 * random.normal(size=1), 0.05 * random.normal(size=(10, 1))
        expected = wanted if preview else wanted[:1]
        mpc.reset()
        long = mpc.control(
            state, d, previous, np.concatenate([expected, np.tile(expected[-1], (150 - len(expected), 1))])
        )
        plan = regulator.control(state, d, previous, wanted)
        assert long.status is Status.SOLVED
        np.testing.assert_allclose(plan.input, long.input, atol=1e-4)


def test_the_output_comes_to_the_reference_whatever_the_disturbance():
    regulator = LinearQuadraticRegulator(LINEAR, PROBLEM)
    state, u, d = np.zeros(2), np.zeros(1), np.array([0.7])
    for _ in range(200):
        u = regulator.control(state, d, u, np.full((10, 1), 0.06)).input
        state = simulate(LINEAR, state, np.tile(u + d, (4, 1)), step=0.005)[-1]
    np.testing.assert_allclose(state, [0.06, 0.0], atol=1e-9)
    np.testing.assert_allclose(u + d, 0.8 + 15.0 * 0.06 / 5.0, atol=1e-9)  # centre + stiffness q / gain


def test_a_constant_force_is_at_rest_under_the_input_that_balances_it():
    regulator = LinearQuadraticRegulator(scalar(0.5, 2.0, constant=3.0), scalar_problem())
    np.testing.assert_allclose(regulator.rest.point, [0.0, -1.5], atol=1e-12)
    plan = regulator.control(np.zeros(1), np.zeros(1), np.array([-1.5]), np.zeros((3, 1)))
    np.testing.assert_allclose(plan.input, -1.5)


def test_inputs_and_their_changes_stay_within_their_bounds():
    regulator = LinearQuadraticRegulator(LINEAR, dataclasses.replace(PROBLEM, rate_limits=(0.5,)))
    random = np.random.default_rng(1)
    for _ in range(200):
        state, previous = random.normal(size=2) * [0.5, 5.0], 20.0 * random.normal(size=1)
        u = regulator.control(state, random.normal(size=1), previous, 0.2 * random.normal(size=(10, 1))).input
        assert np.abs(u) <= 10.0
        assert np.abs(u - np.clip(previous, -10.0, 10.0)) <= 0.5 + 1e-12


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(4))
def test_what_is_not_a_number_holds_the_input(place, value):
    regulator = LinearQuadraticRegulator(LINEAR, PROBLEM)
    asked = [np.zeros(2), np.zeros(1), np.array([3.0]), np.zeros((10, 1))]
    asked[place][0] = value
    plan = regulator.control(*asked)
    assert plan.status is Status.HELD
    assert plan.input[0] == (0.0 if place == 2 else 3.0)


def test_a_model_that_does_not_rest_or_cannot_be_steered_is_refused():
    with pytest.raises(UserError, match="does not rest"):
        LinearQuadraticRegulator(scalar(1.0, 0.0, constant=1.0), scalar_problem())
    with pytest.raises(UserError, match="no linear feedback stabilises"):
        LinearQuadraticRegulator(scalar(1.3, 0.0), scalar_problem())


def test_of_two_inputs_it_is_the_first_input_of_an_mpc_without_bounds_and_without_end():
    free = dataclasses.replace(two_inputs.PROBLEM, input_low=(-1e4,), input_high=(1e4,), input_weights=(0.0,))
    system = two_inputs.Carts()
    regulator = LinearQuadraticRegulator(system, free)
    mpc = ExactMpc(system, dataclasses.replace(free, horizon=120), tolerance=1e-9)
    for seed in range(5):
        state, d, previous, wanted = two_inputs.instance(seed)
        long = mpc.control(state, d, previous, np.concatenate([wanted, np.tile(wanted[-1], (108, 1))]))
        assert long.status is Status.SOLVED
        plan = regulator.control(state, d, previous, wanted)
        np.testing.assert_allclose(plan.input, long.input, atol=1e-4)


def test_one_output_tracked_by_two_inputs_needs_weights_of_the_inputs():
    """Else their difference may drift for ever."""
    one = dataclasses.replace(two_inputs.PROBLEM, output_weights=(50.0, 0.0))
    regulator = LinearQuadraticRegulator(two_inputs.Carts(), one)
    assert np.max(np.abs(np.linalg.eigvals(closed(regulator)))) < 1.0
    with pytest.raises(UserError, match="the inputs need weights"):
        LinearQuadraticRegulator(two_inputs.Carts(), dataclasses.replace(one, input_weights=(0.0,)))


def closed(regulator):
    """The closed loop's matrix of [x, u_-]."""
    n, m = regulator.rest.gain.shape
    through = np.block([[regulator.rest.transition, regulator.rest.gain], [np.zeros((m, n)), np.eye(m)]])
    return through - np.vstack([regulator.rest.gain, np.eye(m)]) @ regulator.feedback


def test_two_outputs_come_to_their_references_whatever_the_disturbances():
    """On arms about a rest that hangs, with small references; the outputs are no states."""
    system = two_inputs.Arms(friction=0.0)
    problem = dataclasses.replace(two_inputs.PROBLEM, input_low=(-10.0,), input_high=(10.0,), input_weights=(0.0,))
    regulator = LinearQuadraticRegulator(system, problem, about=np.array([0.1, -0.05]))
    np.testing.assert_allclose(shown(system, regulator.rest.point[:4], regulator.rest.point[4:]), [0.1, -0.05])
    state, u, d = np.zeros(4), np.zeros(2), np.array([0.2, -0.1])
    for _ in range(400):
        u = regulator.control(state, d, u, np.tile([0.1, -0.05], (12, 1))).input
        state = simulate(system, state, np.tile(u + d, (3, 1)), step=0.05 / 3)[-1]
    np.testing.assert_allclose(shown(system, state, u + d), [0.1, -0.05], atol=1e-6)


def shown(system, x, u):
    """The outputs."""
    return np.array(np.ravel(system.output(x.tolist(), u.tolist())), dtype=float)


def test_with_fewer_inputs_than_tracked_outputs_it_rests_nearest_by_their_weights():
    """One cart is pushed, both are to be elsewhere: at rest they stand together, at the weighted mean."""

    class OneForce(two_inputs.Carts):
        inputs = ("first_force [N]",)  # type: ignore[assignment]

        def law(self, x, u):
            return super().law(x, (u[0], 0.0))

    problem = dataclasses.replace(
        two_inputs.PROBLEM,
        output_weights=(3.0, 1.0),
        output_scales=(1.0,),
        rate_weights=(0.1,),
        input_weights=(0.0,),
        input_low=(-5.0,),
        input_high=(5.0,),
    )
    regulator = LinearQuadraticRegulator(OneForce(), problem)
    np.testing.assert_allclose(regulator.target[:2] @ [1.0, 0.0], [0.75, 0.75])
