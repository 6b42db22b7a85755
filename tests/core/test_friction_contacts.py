"""Maxwell slip, friction that ages at rest, and hysteretic friction, against closed forms and an ordinary solver."""

from itertools import pairwise

import casadi
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hybrid_sysid_ros.core import Ageing, Hysteretic, MaxwellSlip, System, one_step, simulate
from hybrid_sysid_ros.core.friction import fading_stiffnesses, stefanski, stribeck
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.support.errors import UserError

STIFFNESS, LEVEL = fading_stiffnesses(500.0, 4), 2.0  # N/m, N of a block of 1 kg


class Block(System):
    """x'' = f - friction."""

    states = ("place [m]", "speed [m/s]")
    inputs = ("force [N]",)

    def law(self, x, u):
        return x[1], u[0]


class Elements(Block):
    contacts = (MaxwellSlip(on="speed", level=LEVEL, stiffness=STIFFNESS, viscous=3.0),)


class Falling(Block):
    """Elements whose level falls with speed, and which follow it slowly."""

    contacts = (
        MaxwellSlip(
            on="speed", level=lambda s, x, u: stribeck(x[1], 2.0, 3.0, 0.2), stiffness=STIFFNESS, attraction=60
        ),
    )


class Old(Block):
    contacts = (Ageing(on="speed", level=2.0, excess=1.0, rest_time=0.5, memory=0.02),)


class FrictionLoop(Block):
    contacts = (Hysteretic(on="speed", coulomb=2.0, static=3.0, speed_shape=5.0, acceleration_shape=0.5),)


def virgin(way):
    """Friction after a first way from rest: each element a spring, until it slips at its share."""
    return sum(np.minimum(k * way, LEVEL / 4) for k in STIFFNESS)


def dragged(ways):
    """Friction while the elements' block is led along a path: a heavy drive, of which the elements take no notice."""
    h, z, found = 1e-3, np.zeros(4), []
    contact = Elements.contacts[0]
    at = {"viscous": 0.0, "level": LEVEL, "stiffness": list(STIFFNESS), "attraction": 1e12}
    for before, after in pairwise(ways):
        speed = (after - before) / h
        # What must push a block of 1 kg to that speed: the elements' forces are known once their springs are.
        led = np.clip(np.array(STIFFNESS) * (z + h * speed), -LEVEL / 4, LEVEL / 4)
        v, moved = contact.solve(0.0, speed + h * led.sum(), list(z), h, None, at)
        assert float(casadi.DM(v)) == pytest.approx(speed, abs=1e-9)
        z = np.array([float(casadi.DM(item)) for item in moved])
        found.append(float(np.array(STIFFNESS) @ z))
    return np.array(found)


def test_the_first_way_of_maxwell_elements_is_a_chain_of_straight_lines():
    way = np.linspace(0.0, 0.012, 60)
    np.testing.assert_allclose(dragged(way), virgin(way[1:]), atol=1e-9)
    assert virgin(1.0) == pytest.approx(LEVEL)
    assert virgin(1e-6) == pytest.approx(500.0 * 1e-6)


def test_reversals_of_maxwell_elements_follow_masings_rules():
    """A branch from a reversal is the first curve at twice its scale, and a closed loop returns to where it left."""
    top, low = 0.005, 0.001
    up, down, again = np.linspace(0, top, 40), np.linspace(top, low, 40), np.linspace(low, top, 40)
    forces = np.append(0.0, dragged(np.concatenate([up, down[1:], again[1:], np.linspace(top, 0.008, 20)[1:]])))
    branch = forces[39] - 2.0 * virgin((top - down) / 2.0)
    np.testing.assert_allclose(forces[39:79], branch, atol=1e-9)
    assert forces[117] == pytest.approx(forces[39], abs=1e-9)  # the loop is closed
    assert forces[-1] == pytest.approx(virgin(0.008), abs=1e-9)  # and the first curve goes on as if it had not been


def rates_of_elements(t, x):
    """The printed equation, its corners rounded over a thousandth of the level."""
    v, z = x[1], x[2:]
    k, share = np.array(STIFFNESS), LEVEL / 4
    held = 0.5 * (1.0 - np.tanh((np.sign(v) * k * z - share) / (1e-3 * share)))
    return [v, 6.0 * np.sin(2 * np.pi * t) - k @ z - 3.0 * v, *(v * held)]


def test_a_block_on_maxwell_elements_moves_as_its_differential_equation():
    exact = solve_ivp(rates_of_elements, (0, 1.2), np.zeros(6), method="LSODA", rtol=1e-8, atol=1e-11, max_step=1e-3)
    h = 5e-5
    pushes = 6.0 * np.sin(2 * np.pi * (np.arange(24_000) + 0.5) * h)[:, None]
    found = simulate(Elements(), np.zeros(6), pushes, step=h)[-1]
    np.testing.assert_allclose(found[:2], exact.y[:2, -1], rtol=5e-3, atol=6e-4)  # of some .3 m there and back


def test_maxwell_elements_at_steady_speed_give_the_level_of_that_speed():
    """Pushed by the friction of .3 m/s, on the side of Stribeck's curve where heavier friction slows it to a stop."""
    speed, h = 0.3, 1e-4
    level = float(casadi.evalf(casadi.SX(stribeck(speed, 2.0, 3.0, 0.2))))
    state = np.array([0.0, speed, *(LEVEL / 4 / k for k in STIFFNESS)])
    for _ in range(20_000):
        state[1] = speed  # held there
        state = one_step(Falling(), state, np.zeros(1), step=h)
    assert np.dot(STIFFNESS, state[2:]) == pytest.approx(level, rel=1e-3)


@pytest.mark.parametrize(
    ("stiffness", "shares"), [((), ()), ((0.0, 1.0), ()), ((1.0, -2.0), ()), ((1.0, 1.0), (0.5, 0.4)), ((1.0,), (2.0,))]
)
def test_elements_without_stiffness_or_share_are_refused(stiffness, shares):
    with pytest.raises(UserError, match="Maxwell slip on speed"):
        MaxwellSlip(on="speed", level=1.0, stiffness=stiffness, shares=shares)


@pytest.mark.parametrize("rest", [0.0, 0.2, 1.0])
def test_break_away_grows_with_rest_as_its_exponential(rest):
    """Just stopped, then at rest for a while, then pushed hard: F + Fe (1 - exp(-t / T))."""
    h, state = 1e-4, np.array([0.0, 0.0, 1.0])  # the contact just renewed
    for _ in range(round(rest / h)):
        state = one_step(Old(), state, np.zeros(1), step=h)
    low, high = 1.0, 4.0
    for _ in range(40):
        push = 0.5 * (low + high)
        low, high = (low, push) if one_step(Old(), state, np.array([push]), step=h)[1] > 0.0 else (push, high)
    assert push == pytest.approx(2.0 + 1.0 - np.exp(-rest / 0.5), rel=1e-3)


def test_sliding_friction_of_an_aged_contact_weakens_with_speed():
    """a = 1 / (1 + |v| T / L): at .04 m/s half of the excess is left."""
    h, led = 1e-3, Old.contacts[0]
    at = {"viscous": 0.0, "level": 2.0, "creep": 0.0, "excess": 1.0, "rest_time": 0.5, "memory": 0.02}
    renewed, friction = 0.0, 0.0
    for _ in range(5000):
        friction = 2.0 + 1.0 - renewed
        v, (after,) = led.solve(0.04, 0.04 + h * friction, [renewed], h, None, at)
        assert float(v) == pytest.approx(0.04)
        renewed = float(after)
    assert friction == pytest.approx(2.5, rel=1e-3)


def test_hysteretic_friction_is_higher_while_the_speed_grows():
    up, down = (float(casadi.evalf(casadi.SX(stefanski(0.1, a, 2.0, 3.0, 5.0, 0.5)))) for a in (1.0, -1.0))
    excess = np.exp(-5.0 * 0.1 / 1.5)
    assert up == pytest.approx(2.0 + excess)
    assert down == pytest.approx(2.0 - excess)
    assert float(casadi.evalf(casadi.SX(stefanski(0.0, 0.0, 2.0, 3.0, 5.0, 0.5)))) == 3.0  # static at rest
    held = simulate(FrictionLoop(), np.zeros(3), np.full((100, 1), 2.99), step=1e-3)
    assert np.all(held[:, 1] == 0.0)
    assert simulate(FrictionLoop(), np.zeros(3), np.full((100, 1), 3.01), step=1e-3)[-1, 1] > 0.0


@pytest.mark.parametrize("system", [Elements(), Falling(), Old(), FrictionLoop()], ids=lambda s: type(s).__name__)
def test_the_smoothed_step_tends_to_the_exact_one(system):
    random, n = np.random.default_rng(0), len(system.states)
    exact, smooth = (symbolic_step(system, step=1e-3, smoothing=s) for s in (0.0, 1e-7))
    for _ in range(30):
        state = np.array([0.0, *random.normal(size=n - 1) * 0.05])
        state[2:] = np.abs(state[2:]) if isinstance(system, Old) else 0.02 * state[2:]
        push = random.uniform(-8, 8)
        np.testing.assert_allclose(np.array(smooth(state, push)), np.array(exact(state, push)), rtol=1e-3, atol=2e-5)


@pytest.mark.parametrize("system", [Elements(), Old(), FrictionLoop()], ids=lambda s: type(s).__name__)
def test_the_smoothed_step_has_derivatives_at_rest(system):
    x, u = casadi.SX.sym("x", len(system.states)), casadi.SX.sym("u")
    step = symbolic_step(system, step=1e-3, smoothing=0.01)
    jacobian = casadi.Function("jacobian", [x, u], [casadi.jacobian(step(x, u), casadi.vertcat(x, u))])
    found = np.array(jacobian(np.zeros(len(system.states)), 0.0))
    assert np.isfinite(found).all()
    assert found[1, -1] > 0.0  # a push moves it
