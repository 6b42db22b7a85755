"""Bristles: friction before sliding, against differential equations, closed forms and energy."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hybrid_sysid_ros.core import one_step, simulate
from tests.one_joint import Dahl, LuGre

FREE = {"gain": 1.0, "centre": 0.0, "stiffness": 0.0, "input_delay": 0.0}
"""A block on a table that the input pushes: v' = u - friction."""

DAHL = Dahl(**FREE, damping=0.0, coulomb=2.0, bristle_stiffness=500.0)
LUGRE = LuGre(
    **FREE,
    damping=3.0,
    coulomb=2.0,
    static_excess=1.0,
    stribeck_speed=0.1,
    bristle_stiffness=500.0,
    bristle_damping=5.0,
)


def step(system, state, push, h):
    return one_step(system, np.array(state), np.array([push]), step=h)


def pushes(t):
    """Breaks the block away, lets it slide, and turns it round: three times within 3 s."""
    return 6.0 * np.sin(2 * np.pi * t)


def solved(system, seconds):
    """The differential equation as it is printed, by an ordinary solver."""

    def level(v):
        if isinstance(system, Dahl):
            return system.coulomb
        return system.coulomb + system.static_excess * np.exp(-((v / system.stribeck_speed) ** 2))

    def rates(t, x):
        _, v, z = x
        bending = v - abs(v) * z * system.bristle_stiffness / level(v)
        s1 = getattr(system, "bristle_damping", 0.0)
        friction = system.bristle_stiffness * z + s1 * bending + system.damping * v
        return [v, pushes(t) - friction, bending]

    exact = solve_ivp(rates, (0.0, seconds), np.zeros(3), method="LSODA", rtol=1e-9, atol=1e-11, max_step=1e-3)
    assert np.min(exact.y[1]) < -0.2 < 0.2 < np.max(exact.y[1])  # it slides both ways
    return exact.y[:, -1]


@pytest.mark.parametrize("system", [DAHL, LUGRE], ids=["Dahl", "LuGre"])
def test_it_moves_as_its_differential_equation_through_sliding_and_reversal(system):
    seconds = 1.3
    exact = solved(system, seconds)
    errors = []
    for h in (2e-4, 1e-4, 5e-5):
        middles = (np.arange(round(seconds / h)) + 0.5) * h
        end = simulate(system, np.zeros(3), pushes(middles)[:, None], step=h)[-1]
        errors.append(np.max(np.abs(end - exact) / np.abs(exact)))
    assert errors[-1] < 2e-3
    assert errors[2] < 0.6 * errors[1] < 0.4 * errors[0]  # first order, as the scheme for dry friction


def test_the_step_is_backward_euler_to_the_last_digits():
    """Both implicit equations hold: z+ = z + h (v+ - |v+| s0 z+ / F), v+ = v + h (u - s0 z+ - s1 z'+)."""
    random = np.random.default_rng(0)
    for _ in range(2000):
        stiffness, damping = 10 ** random.uniform(0, 5), random.choice([0.0, 10 ** random.uniform(-2, 2)])
        level, h = 10 ** random.uniform(-3, 1), 10 ** random.uniform(-5, -2)
        # A Stribeck curve without an excess is a constant.
        system = dataclasses.replace(
            LUGRE, damping=0.0, coulomb=level, static_excess=0.0, bristle_stiffness=stiffness, bristle_damping=damping
        )
        state = [0.0, random.normal(), 1.5 * random.uniform(-1, 1) * level / stiffness]
        push = 5.0 * random.normal()
        _, v, z = step(system, state, push, h)
        bending = v - abs(v) * stiffness * z / level
        assert z == pytest.approx(state[2] + h * bending, rel=1e-6, abs=1e-9 * level / stiffness)
        expected = state[1] + h * (push - stiffness * z - damping * (z - state[2]) / h)
        assert v == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("push", [2.5, -7.0])
def test_a_block_that_slides_steadily_is_held_back_by_the_friction_level(push):
    system = dataclasses.replace(DAHL, damping=4.0)
    x = simulate(system, np.zeros(3), np.full((4000, 1), push), step=0.001)[-1]
    assert system.bristle_stiffness * x[2] == pytest.approx(np.sign(push) * 2.0, rel=1e-6)
    assert x[1] == pytest.approx(np.sign(push) * (abs(push) - 2.0) / 4.0, rel=1e-6)


def test_before_it_slides_friction_grows_by_dahls_exponential():
    """F = Fc (1 - exp(-s0 q / Fc)) on the way out, whatever the speed: Dahl's law knows no rate."""
    for push in (3.0, 12.0):
        x = simulate(DAHL, np.zeros(3), np.full((2000, 1), push), step=1e-5)
        assert np.all(np.diff(x[:, 0]) > 0)
        expected = 2.0 * (1 - np.exp(-500.0 * x[:, 0] / 2.0))
        np.testing.assert_allclose(500.0 * x[:, 2], expected, atol=2e-3)


def test_a_small_pull_bends_a_spring_and_is_given_back():
    """At a hundredth of the level bristles are a spring of s0: the block moves by u / s0, and returns."""
    system = dataclasses.replace(DAHL, damping=50.0)
    pull = 0.02
    inputs = np.repeat([pull, 0.0], 4000)[:, None]
    x = simulate(system, np.zeros(3), inputs, step=0.001)
    assert x[4000, 0] == pytest.approx(pull / 500.0, rel=0.01)
    assert abs(x[-1, 0]) < 0.01 * x[4000, 0]


def test_a_block_on_its_bristles_swings_with_the_root_of_their_stiffness():
    x = simulate(DAHL, np.array([0.0, 1e-5, 0.0]), np.zeros((100_000, 1)), step=1e-5)
    crossings = np.flatnonzero(np.diff(np.sign(x[:, 0])) > 0) * 1e-5
    np.testing.assert_allclose(np.diff(crossings), 2 * np.pi / np.sqrt(500.0), rtol=0.01)


def test_stiff_bristles_are_dry_friction():
    """A sliding block stops after v^2 / (2 F), as on a dry table."""
    system = dataclasses.replace(DAHL, bristle_stiffness=1e5)
    x = simulate(system, np.array([0.0, 0.5, 0.0]), np.zeros((10_000, 1)), step=1e-4)
    assert x[-1, 0] == pytest.approx(0.5**2 / (2 * 2.0), rel=2e-3)
    assert abs(x[-1, 1]) < 1e-4  # Dahl's bristles alone hardly damp what is left


def anywhere(random):
    """A model, a state with its bristles bent beyond what they bear at times, a push and a step."""
    model = random.choice([0, 1])
    system = dataclasses.replace(
        (DAHL, LUGRE)[model], bristle_stiffness=10 ** random.uniform(0, 5), coulomb=10 ** random.uniform(-3, 1)
    )
    bent = 2.0 * random.uniform(-1, 1) * system.coulomb / system.bristle_stiffness
    return system, [0.0, random.normal(), bent], 10 * random.normal(), 10 ** random.uniform(-5, -1)


def test_bristles_never_bear_more_than_the_friction_level():
    random = np.random.default_rng(0)
    for _ in range(3000):
        system, state, push, h = anywhere(random)
        level = system.coulomb + getattr(system, "static_excess", 0.0)
        most = max(system.bristle_stiffness * abs(state[2]), level)
        assert system.bristle_stiffness * abs(step(system, state, push, h)[2]) <= most * (1 + 1e-9)


def test_a_block_that_is_left_alone_never_gains_energy():
    """v^2 / 2 + s0 z^2 / 2 falls in every step of Dahl's, however long and however stiff.

    LuGre's need not: damped bristles are passive under a condition only (Barabanov and Ortega 2000, IEEE TAC 45(4)).
    """
    random = np.random.default_rng(1)
    for _ in range(1000):
        drawn, state, _, h = anywhere(random)
        system = dataclasses.replace(DAHL, coulomb=drawn.coulomb, bristle_stiffness=drawn.bristle_stiffness)
        energy = [state[1] ** 2 + system.bristle_stiffness * state[2] ** 2]
        for _ in range(5):
            state = step(system, state, 0.0, h)
            energy.append(state[1] ** 2 + system.bristle_stiffness * state[2] ** 2)
        assert np.all(np.diff(energy) <= 1e-9 * energy[0])


@pytest.mark.parametrize("system", [DAHL, LUGRE], ids=["Dahl", "LuGre"])
def test_a_step_of_5_ms_is_stable_on_the_stiffest_bristles(system):
    """h sqrt(s0) = 1.6: an explicit step would be near its limit, and h s0 |v| / F = 250 |v| far beyond it."""
    stiff = dataclasses.replace(system, bristle_stiffness=1e5, damping=5.0)
    volts = np.random.default_rng(0).uniform(-10, 10, 400).repeat(50)[:, None]
    x = simulate(stiff, np.zeros(3), volts, step=0.005)
    assert np.max(np.abs(x[:, 1])) <= (10.0 - 2.0) / 5.0 + 1e-9  # terminal speed: (push - Fc) / D
    assert np.max(np.abs(x[:, 1])) > 0.5
    assert np.max(np.abs(1e5 * x[:, 2])) <= system.coulomb + getattr(system, "static_excess", 0.0) + 1e-9
    fine = simulate(stiff, np.zeros(3), volts.repeat(10, axis=0), step=0.0005, every=10)
    assert np.sqrt(np.mean((x - fine)[:, 1] ** 2)) < 0.02 * np.std(fine[:, 1])


@pytest.mark.parametrize("bristle_damping", [0.0, 5.0, 100.0])
@pytest.mark.parametrize("speed", [0.02, 0.1, -0.1, 0.4])
def test_steady_lugre_friction_is_the_stribeck_curve(speed, bristle_damping):
    """F(v) + D v, on the falling part too; the bristles' own damping has no part in it, since z' = 0."""
    system = dataclasses.replace(LUGRE, damping=50.0, bristle_damping=bristle_damping)
    curve = 2.0 + 1.0 * np.exp(-((speed / 0.1) ** 2))
    push = np.sign(speed) * curve + 50.0 * speed
    x = simulate(system, np.zeros(3), np.full((20_000, 1), push), step=0.001)[-1]
    assert x[1] == pytest.approx(speed, rel=1e-6)
    assert 500.0 * x[2] == pytest.approx(np.sign(speed) * curve, rel=1e-6)


def test_bristles_without_a_level_do_not_hold_anything():
    system = dataclasses.replace(DAHL, coulomb=0.0)
    x = simulate(system, np.zeros(3), np.full((1000, 1), 2.5), step=0.001)
    np.testing.assert_allclose(x[-1, 1], 2.5, rtol=1e-9)
    assert np.all(np.abs(x[:, 2]) < 1e-9)
