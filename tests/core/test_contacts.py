"""Contacts: school physics of viscous and dry friction, and several contacts beside each other."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hybrid_sysid_ros.core import Bristles, Dry, System, bounded, one_step, simulate
from tests.one_joint import Linear


def test_viscous_friction_converges_with_the_square_of_the_step():
    """v' = -D v from v(0) is v(0) exp(-D t); Euler's would converge with the step only."""
    system = Linear(gain=5.0, centre=0.0, stiffness=0.0, damping=26.0, input_delay=0.0)
    exact = 0.7 * np.exp(-26.0 * 0.1)
    errors = []
    for steps in (10, 20, 40, 80):
        speed = simulate(system, np.array([0.0, 0.7]), np.zeros((steps, 1)), step=0.1 / steps)[-1, 1]
        errors.append(abs(speed - exact))
    assert errors[1] < 0.02 * exact  # at the 5 ms of identification
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.05)


def test_viscous_friction_stops_at_the_terminal_speed_at_any_step():
    """Drive over damping, gain u / D: what the step does to the way there, it does not do to the end."""
    system = Linear(gain=5.0, centre=0.5, stiffness=0.0, damping=26.0, input_delay=0.0)
    for step in (1e-3, 5e-3, 0.05):
        states = simulate(system, np.zeros(2), np.full((round(3.0 / step), 1), 2.5), step=step)
        assert states[-1, 1] == pytest.approx(5.0 * (2.5 - 0.5) / 26.0, rel=1e-9)


def test_a_block_sticks_exactly_below_the_break_away_force(slider):
    for push in (0.0, 1.0, -1.999):
        states = simulate(slider, np.zeros(2), np.full((1000, 1), push), step=0.001)
        assert np.all(states == 0.0)


def test_a_block_slips_above_the_break_away_force(slider):
    states = simulate(slider, np.zeros(2), np.full((1000, 1), 2.5), step=0.001)
    assert states[-1, 1] == pytest.approx((2.5 - 2.0) * 1.0, rel=1e-9)
    assert states[-1, 0] == pytest.approx(0.5 * (2.5 - 2.0) * 1.0**2, rel=2e-3)


@pytest.mark.parametrize("speed", [0.3, -1.7])
def test_a_sliding_block_stops_after_the_square_of_its_speed_over_twice_the_friction(slider, speed):
    states = simulate(slider, np.array([0.0, speed]), np.zeros((20_000, 1)), step=1e-4)
    assert states[-1, 0] == pytest.approx(np.sign(speed) * speed**2 / (2 * 2.0), abs=1e-4 * abs(speed))
    stops = np.flatnonzero(states[:, 1] == 0.0)[0] * 1e-4
    assert stops == pytest.approx(abs(speed) / 2.0, abs=1.5e-4)
    assert np.all(states[:, 1] * speed >= 0)  # friction stops it and never turns it round


def test_a_stuck_block_has_lost_its_speed_to_the_last_bit(slider):
    """Whatever brought it below what friction can hold in one step."""
    random = np.random.default_rng(0)
    for _ in range(1000):
        h = 10 ** random.uniform(-5, -2)
        speed = random.uniform(-1, 1) * 2.0 * h
        assert one_step(slider, np.array([0.3, speed]), np.zeros(1), step=h)[1] == 0.0


def test_two_joints_on_a_spring_move_as_their_differential_equation(flexible_joint):
    """At speeds of one sign, where an ordinary solver can integrate dry friction."""

    def rates(t, x):
        spring = 12.0 * (x[0] - x[1])
        motor = (1.5 - spring - 0.05 * x[2] - 0.25) / 0.012
        return [x[2], x[3], motor, (spring - 0.02 * x[3]) / 0.05]

    start = np.array([0.0, 0.0, 20.0, 20.0])
    exact = solve_ivp(rates, (0, 0.3), start, rtol=1e-10, atol=1e-12)
    assert np.all(exact.y[2] > 0)
    simulated = simulate(flexible_joint, start, np.full((30_000, 1), 1.5), step=1e-5)[-1]
    np.testing.assert_allclose(simulated, exact.y[:, -1], rtol=2e-3)


def test_the_motor_of_a_flexible_joint_holds_the_link_by_friction(flexible_joint):
    """A deflection of F / k is held; the link then swings about it against its own drag only."""
    stuck = simulate(flexible_joint, np.array([0.0, 0.02, 0.0, 0.0]), np.zeros((4000, 1)), step=0.001)
    assert 12.0 * 0.02 < 0.25
    assert np.all(stuck[:, [0, 2]] == 0.0)
    assert abs(stuck[-1, 1]) < 0.02
    freed = simulate(flexible_joint, np.array([0.0, 0.03, 0.0, 0.0]), np.zeros((10, 1)), step=0.001)
    assert 12.0 * 0.03 > 0.25
    assert freed[-1, 0] > 0.0


@dataclass(frozen=True, kw_only=True)
class Pair(System):
    """A block that is pushed, dry on its table, and one on bristles that a spring ties to it."""

    states = ("front [m]", "back [m]", "front_speed [m/s]", "back_speed [m/s]")
    inputs = ("push [m/s^2]",)
    contacts = (
        Dry(on="front_speed", level=2.0, viscous="drag"),
        Bristles(on="back_speed", level="grip", stiffness=500.0, viscous=0.5),
    )

    spring: float = bounded(40.0, 0.0, 100.0, unit="1/s^2")
    """Between them."""
    drag: float = bounded(1.0, 0.0, 10.0, unit="1/s")
    """Of the front one."""
    grip: float = bounded(1.0, 0.0, 10.0, unit="m/s^2")
    """Level of the bristles."""

    def law(self, x, u):
        pull = self.spring * (x[0] - x[1])
        return x[2], x[3], u[0] - pull, pull


def test_a_dry_contact_beside_one_of_bristles_moves_as_its_differential_equation():
    """At front speeds of one sign, where an ordinary solver can integrate dry friction."""

    def rates(t, x):
        pull = 40.0 * (x[0] - x[1])
        return [
            x[2],
            x[3],
            12.0 - pull - 2.0 - x[2],
            pull - 500.0 * x[4] - 0.5 * x[3],
            x[3] - abs(x[3]) * x[4] * 500.0 / 1.0,
        ]

    start = np.array([0.0, 0.0, 1.5, 1.0, 0.0])
    exact = solve_ivp(rates, (0, 0.5), start, method="LSODA", rtol=1e-10, atol=1e-12)
    assert np.all(exact.y[2] > 0)
    found = simulate(Pair(), start, np.full((50_000, 1), 12.0), step=1e-5)[-1]
    np.testing.assert_allclose(found, exact.y[:, -1], rtol=1e-3)


def test_each_contact_holds_its_own_block():
    """A pull that the table bears: the front one sticks to the last bit, the back one bends its bristles."""
    states = simulate(Pair(), np.array([0.0, 0.01, 0.0, 0.0, 0.0]), np.zeros((20_000, 1)), step=1e-3)
    assert np.all(states[:, [0, 2]] == 0.0)
    # At rest the spring's pull is what the bristles bear: 40 q = -500 z.
    assert states[-1, 3] == pytest.approx(0.0, abs=1e-6)
    assert -40.0 * states[-1, 1] == pytest.approx(500.0 * states[-1, 4], rel=1e-3, abs=1e-6)


def test_a_deflection_is_a_hidden_state_in_the_unit_of_its_position():
    assert [str(item) for item in Pair().states][-1] == "deflection [m]"
    assert [item.name for item in Pair().declared_states] == ["front", "back", "front_speed", "back_speed"]
    assert dict(Pair().kinematics) == {0: 2, 1: 3}


@dataclass(frozen=True, kw_only=True)
class Plane(System):
    """A puck on a table in two directions, each with its own friction: two contacts on two velocities."""

    states = ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]")
    inputs = ("ax [m/s^2]", "ay [m/s^2]")
    contacts = (Dry(on="vx", level=2.0), Dry(on="vy", level="across"))

    across: float = bounded(0.5, 0.0, 10.0, unit="m/s^2")
    """Friction along y."""

    def law(self, x, u):
        return x[2], x[3], u[0], u[1]


def test_two_contacts_on_two_velocities_stick_and_slip_each_for_itself():
    states = simulate(Plane(), np.array([0.0, 0.0, 0.0, 1.0]), np.tile([1.9, 0.0], (30_000, 1)), step=1e-4)
    assert np.all(states[:, [0, 2]] == 0.0)
    assert states[-1, 1] == pytest.approx(1.0**2 / (2 * 0.5), abs=1e-4)
    assert states[-1, 3] == 0.0
