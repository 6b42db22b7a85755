"""Steppers: orders of convergence against closed forms and scipy, and energy that stays."""

from dataclasses import dataclass

import casadi
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from hybrid_sysid_ros.core import Recurrence, RungeKutta, System, bounded, one_step, simulate, step_with_jacobian
from hybrid_sysid_ros.core.chain_rule import padded
from hybrid_sysid_ros.core.compiled import compiled
from hybrid_sysid_ros.core.mathematics import cos, sin
from hybrid_sysid_ros.core.rollout import _step_with_jacobian
from tests.evaluation import parametric_step
from tests.one_joint import Linear


def test_the_linear_simulation_tends_to_the_matrix_exponential():
    system = Linear(gain=5.0, centre=0.7, stiffness=30.0, damping=4.0, input_delay=0.0)
    x, u, seconds = np.array([0.1, -0.4]), 2.5, 0.8
    matrix = np.array([[0.0, 1.0, 0.0], [-30.0, -4.0, 5.0 * (u - 0.7)], [0.0, 0.0, 0.0]])
    exact = (expm(matrix * seconds) @ np.append(x, 1.0))[:2]
    errors = []
    for steps in (800, 1600, 3200):
        simulated = simulate(system, x, np.full((steps, 1), u), step=seconds / steps)[-1]
        errors.append(np.linalg.norm(simulated - exact))
    assert errors[-1] < 1e-3 * np.linalg.norm(exact)
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0, rtol=0.02)  # first order


def test_an_undamped_spring_swings_for_ever():
    # Semi-implicit Euler is symplectic: explicit Euler would gain exp(h w^2 t / 2) = e^1000 here.
    system = Linear(gain=5.0, centre=0.0, stiffness=400.0, damping=0.0, input_delay=0.0)
    x = simulate(system, np.array([0.1, 0.0]), np.zeros((1_000_000, 1)), step=0.005, every=10)
    energy = 0.5 * x[:, 1] ** 2 + 200.0 * x[:, 0] ** 2
    assert np.all(np.abs(energy / energy[0] - 1) < 0.06)  # h w / 2 = 5 %


def test_a_motor_of_three_states_moves_as_its_differential_equation(motor):
    def rates(t, x):
        voltage = 6.0 if t < 0.5 else -3.0
        return [x[1], 1.5 * x[2] - 0.8 * x[1], (voltage - 2.0 * x[2] - 1.5 * x[1]) / 0.1]

    half = solve_ivp(rates, (0, 0.5 - 1e-12), np.zeros(3), rtol=1e-10, atol=1e-12)
    exact = solve_ivp(rates, (0.5, 1.0), half.y[:, -1], rtol=1e-10, atol=1e-12).y[:, -1]
    inputs = np.repeat([6.0, -3.0], 25_000)[:, None]
    np.testing.assert_allclose(simulate(motor, np.zeros(3), inputs, step=2e-5)[-1], exact, rtol=2e-3)


@dataclass(frozen=True, kw_only=True)
class CartPendulum(System):
    """A pendulum on a cart that is accelerated: q'' = -w^2 sin q - u cos q - d q'."""

    states = ("angle [rad]", "rate [rad/s]")
    inputs = ("acceleration [m/s^2]",)
    stepper = RungeKutta()

    frequency: float = bounded(5.0, 0.1, 20.0, unit="rad/s")
    """w, of small swings."""
    damping: float = bounded(0.3, 0.0, 5.0, unit="1/s")
    """d."""

    def law(self, x, u):
        q, v = x
        return v, -(self.frequency**2) * sin(q) - u[0] * cos(q) - self.damping * v


def test_runge_kutta_is_of_order_four():
    def rates(t, x):
        return [x[1], -25.0 * np.sin(x[0]) - 3.0 * np.cos(x[0]) - 0.3 * x[1]]

    start = np.array([1.2, -0.5])
    exact = solve_ivp(rates, (0.0, 1.0), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    errors = [
        np.linalg.norm(simulate(CartPendulum(), start, np.full((steps, 1), 3.0), step=1.0 / steps)[-1] - exact)
        for steps in (25, 50, 100, 200)
    ]
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 4.0, atol=0.15)
    assert errors[-1] < 2e-8


def test_the_slopes_of_a_runge_kutta_step_are_casadis():
    """Stages and chain rule are loops about the printed law in one form, and written out in the other."""
    system, h = CartPendulum(), 0.05
    x, u, p, following = parametric_step(system, step=h)
    expected = casadi.Function("j", [x, u, p], [casadi.jacobian(following, casadi.vertcat(x, u, p))])
    random = np.random.default_rng(0)
    for _ in range(20):
        state, drive = random.normal(size=2), random.normal(size=1)
        np.testing.assert_allclose(
            jacobian(system, state, drive, h), np.array(expected(state, drive, system.values)), rtol=1e-11, atol=1e-14
        )


@pytest.mark.parametrize(
    "system", [CartPendulum(), Linear(gain=5.0, centre=0.7, stiffness=30.0, damping=4.0, input_delay=0.0)]
)
def test_derivatives_go_on_from_step_to_step_by_the_chain_rule(system):
    h, x, u = 0.05, np.array([0.4, -0.7]), np.array([0.3])
    function, _ = compiled(system).jacobian(through=True)
    found, expected, following = np.eye(3, padded(3)), np.eye(3), np.empty(2)
    for _ in range(3):
        expected[:2] = step_with_jacobian(system, x, u, step=h)[1] @ expected
        _step_with_jacobian(function, x, u, system.values, system.weights, h, 0.0, following, found)
        x = following.copy()
    np.testing.assert_allclose(found[:, :3], expected, rtol=1e-13, atol=1e-15)


def jacobian(system, x, u, h):
    """By states, inputs and parameters."""
    return step_with_jacobian(system, x, u, step=h, learn=True)[1]


@dataclass(frozen=True, kw_only=True)
class Bank(Recurrence):
    """Savings that earn interest, and what was paid in a period ago."""

    states = ("savings [EUR]", "paid [EUR]")
    inputs = ("payment [EUR]",)
    period: float = 1.0

    interest: float = bounded(0.05, 0.0, 1.0, unit="1")
    """In each period."""

    def law(self, x, u):
        return (1.0 + self.interest) * x[0] + u[0], u[0]


def test_a_sampled_law_is_the_map_itself():
    found = simulate(Bank(), np.array([100.0, 0.0]), np.full((3, 1), 10.0), step=1.0)
    np.testing.assert_allclose(found[:, 0], [100.0, 115.0, 130.75, 147.2875])
    assert not Bank().kinematics  # a shifted state is no position
    np.testing.assert_allclose(one_step(Bank(), np.array([1.0, 2.0]), np.array([3.0]), step=1.0), [4.05, 3.0])
