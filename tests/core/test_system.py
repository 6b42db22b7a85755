"""Equations written once: both forms agree, and both obey school physics and textbook solutions."""

import dataclasses

import numpy as np
import pytest
from hybrid_sysid_ros.core.casadi_form import symbolic_step
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from hybrid_sysid_ros.core import COMPILED, kernels, parameter, simulate
from hybrid_sysid_ros.models import STRUCTURES, build
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import Linear

RANGE = np.array([0.15, 0.5, 10.0])  # position [rad], velocity [rad/s], drive [V] of the beam's records
DEFLECTION = 0.005  # of bristles, as far as they bend [rad]
MOTIONS = [name for name in STRUCTURES if name not in ("narx", "recurrent")]


def structure(name, seed=0):
    """A structure with every parameter away from its start, and a network that matters."""
    random = np.random.default_rng(seed)
    system, _ = build(name, CamBeam(), scales=RANGE, seed=seed)
    values = [item.start + 0.1 * item.scale * random.uniform(-1, 1) for item in system.parameters]
    bounded = [np.clip(v, item.low, item.high) for v, item in zip(values, system.parameters, strict=True)]
    system = system.with_values(np.array(bounded))
    return system.with_weights(random.normal(size=len(system.weights))) if len(system.weights) else system


def compiled_step(system, x, u, h):
    following = np.empty(len(system.states))
    kernels(system).step(x, u, system.named, system.weights, h, following)
    return following


def points(count=200, seed=1):
    random = np.random.default_rng(seed)
    for _ in range(count):
        # Half of the points are slow: there dry friction decides.
        slow = random.choice([1e-3, 1.0])
        yield random.uniform(-1.5, 1.5, 3) * RANGE * np.array([1.0, slow, 1.0])


@pytest.mark.parametrize("name", MOTIONS)
def test_the_compiled_and_the_casadi_form_agree(name):
    system = structure(name)
    symbolic = symbolic_step(system, step=0.005)
    random = np.random.default_rng(2)
    for x in points():
        hidden = DEFLECTION * random.uniform(-1, 1, len(system.states) - 2)
        state = np.concatenate([x[:2], hidden])
        expected = np.array(symbolic(state, x[2:])).ravel()
        np.testing.assert_allclose(compiled_step(system, state, x[2:], 0.005), expected, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("name", ["stribeck", "gray", "hybrid"])
def test_the_smooth_form_is_off_by_half_its_smoothing_at_most(name):
    # (sqrt((x + L)^2 + s^2) - sqrt((x - L)^2 + s^2)) / 2 lies within s / 2 of x held within +-L.
    system = structure(name)
    largest = []
    for smoothing in (1e-2, 1e-4, 1e-6):
        symbolic = symbolic_step(system, step=0.005, smoothing=smoothing)
        errors = [
            abs(compiled_step(system, x[:2], x[2:], 0.005)[1] - float(symbolic(x[:2], x[2:])[1])) for x in points()
        ]
        assert max(errors) <= smoothing / 2 * (1 + 1e-6)
        largest.append(max(errors))
    assert largest[0] > 1e-4  # or the points would never have met a corner


def test_substeps_are_steps_in_turn():
    system = structure("gray")
    x, u = np.array([0.02, -0.1]), np.array([3.0])
    expected = x
    for _ in range(4):
        expected = compiled_step(system, expected, u, 0.005)
    symbolic = symbolic_step(system, step=0.005, substeps=4)
    np.testing.assert_allclose(np.array(symbolic(x, u)).ravel(), expected, rtol=1e-12)


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


def test_an_undamped_spring_swings_for_ever():
    # Semi-implicit Euler is symplectic: explicit Euler would gain exp(h w^2 t / 2) = e^1000 here.
    system = Linear(gain=5.0, centre=0.0, stiffness=400.0, damping=0.0, input_delay=0.0)
    x = simulate(system, np.array([0.1, 0.0]), np.zeros((1_000_000, 1)), step=0.005, every=10)
    energy = 0.5 * x[:, 1] ** 2 + 200.0 * x[:, 0] ** 2
    assert np.all(np.abs(energy / energy[0] - 1) < 0.06)  # h w / 2 = 5 %


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
        assert compiled_step(slider, np.array([0.3, speed]), np.zeros(1), h)[1] == 0.0


def seen_through(inputs, delay, step, parts=1000):
    """Means over each step of a held input that comes late, by counting fine parts of the steps."""
    middle = (np.arange(len(inputs) * parts) + 0.5) * step / parts - delay
    index = np.clip(np.floor(middle / step).astype(int), 0, None)
    return inputs[index].reshape(len(inputs), parts).mean(axis=1)


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.010, 0.0125, 0.0021])
def test_a_delay_shifts_the_held_input_and_averages_it_over_each_step(slider, delay):
    inputs = np.random.default_rng(0).uniform(3, 9, 60)
    late = simulate(dataclasses.replace(slider, input_delay=delay), np.zeros(2), inputs[:, None], step=0.005)
    shifted = simulate(slider, np.zeros(2), seen_through(inputs, delay, 0.005)[:, None], step=0.005)
    np.testing.assert_allclose(late, shifted, rtol=2e-3, atol=1e-5)


def test_a_delay_of_two_and_a_half_steps_by_hand(slider):
    inputs = np.array([[4.0], [6.0], [3.0], [9.0], [9.0]])
    system = dataclasses.replace(slider, input_delay=0.25)
    speeds = simulate(system, np.zeros(2), inputs, step=0.1)[:, 1]
    # The input seen is 4 until 0.35 s, 6 until 0.45 s, then 3: its means over each 0.1 s follow.
    np.testing.assert_allclose(np.diff(speeds) / 0.1 + 2.0, [4.0, 4.0, 4.0, 5.0, 4.5])


def test_every_record_of_several_begins_with_its_own_input(slider):
    """No input leaks from the record before through the delay."""
    system = dataclasses.replace(slider, input_delay=0.012)
    inputs = np.concatenate([np.full((40, 1), 9.0), np.full((40, 1), 3.0)])
    out = np.empty((18, 2))
    starts = np.array([[0, 0, 9, 0], [40, 40, 9, 9]])
    kernels(system).windows(
        starts, np.zeros((2, 2)), inputs, 0.012 / 0.005, 5, system.named, system.weights, 0.005, out
    )
    np.testing.assert_array_equal(out[9:], simulate(system, np.zeros(2), inputs[40:], step=0.005, every=5))


def test_nothing_grows_outside_the_range_that_was_identified():
    beam = CamBeam(range_low=-0.1, range_high=0.1, range_speed=2.0)
    law = beam.law(COMPILED)

    def at(q, v=0.3):
        (_, acceleration), (level, *_) = law(np.array([q, v]), np.array([2.0]), beam.named, beam.weights)
        return acceleration + beam.stiffness * q, level

    for edge, far in ((0.1, 5.0), (-0.1, -5.0)):
        np.testing.assert_allclose(at(far), at(edge), rtol=1e-12)
        for fast in (1.0, -1.0):
            np.testing.assert_allclose(at(far, fast * 1e6), at(edge, fast * 2.0), rtol=1e-12)
            assert abs(at(edge, fast * 2.0)[0] - at(edge)[0]) > 1.0  # or speed would not matter at all


@pytest.mark.parametrize("name", ["black_box", "hybrid"])
def test_a_network_is_bounded_however_far_it_is_asked(name):
    system = structure(name)
    silent = system.with_weights(np.zeros(len(system.weights)))
    output_weights = system.weights.reshape(-1, 5)[:, -1]
    bound = system.network.scale * np.sum(np.abs(output_weights))
    law = system.law(COMPILED)
    for x in points():
        for far in (x, 1e3 * x):
            rates = [law(far[:2], far[2:], item.named, item.weights)[0][1] for item in (system, silent)]
            assert abs(rates[0] - rates[1]) <= bound * (1 + 1e-9)


def test_a_motor_of_three_states_moves_as_its_differential_equation(motor):
    def rates(t, x):
        voltage = 6.0 if t < 0.5 else -3.0
        return [x[1], 1.5 * x[2] - 0.8 * x[1], (voltage - 2.0 * x[2] - 1.5 * x[1]) / 0.1]

    half = solve_ivp(rates, (0, 0.5 - 1e-12), np.zeros(3), rtol=1e-10, atol=1e-12)
    exact = solve_ivp(rates, (0.5, 1.0), half.y[:, -1], rtol=1e-10, atol=1e-12).y[:, -1]
    inputs = np.repeat([6.0, -3.0], 25_000)[:, None]
    np.testing.assert_allclose(simulate(motor, np.zeros(3), inputs, step=2e-5)[-1], exact, rtol=2e-3)


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


def test_two_joints_agree_in_both_forms(flexible_joint, motor):
    random = np.random.default_rng(0)
    for system in (flexible_joint, motor):
        symbolic = symbolic_step(system, step=0.002)
        for _ in range(100):
            x, u = random.normal(size=len(system.states)), random.normal(size=1)
            expected = np.array(symbolic(x, u)).ravel()
            np.testing.assert_allclose(compiled_step(system, x, u, 0.002), expected, rtol=1e-12, atol=1e-14)


def test_the_motor_of_a_flexible_joint_holds_the_link_by_friction(flexible_joint):
    """A deflection of F / k is held; the link then swings about it against its own drag only."""
    stuck = simulate(flexible_joint, np.array([0.0, 0.02, 0.0, 0.0]), np.zeros((4000, 1)), step=0.001)
    assert 12.0 * 0.02 < 0.25
    assert np.all(stuck[:, [0, 2]] == 0.0)
    assert abs(stuck[-1, 1]) < 0.02
    freed = simulate(flexible_joint, np.array([0.0, 0.03, 0.0, 0.0]), np.zeros((10, 1)), step=0.001)
    assert 12.0 * 0.03 > 0.25
    assert freed[-1, 0] > 0.0


def test_a_parameter_outside_its_bounds_is_named():
    Linear().check()
    with pytest.raises(UserError, match=r"Linear: parameter damping = -1 1/s is outside \[0, 150\]"):
        Linear(damping=-1.0).check()
    with pytest.raises(UserError, match="parameter gain = nan"):
        Linear(gain=float("nan")).check()
    with pytest.raises(ValueError, match="spring: value 3"):
        parameter(3.0, 0.0, 2.0, unit="N/m", description="spring")


def test_an_equation_without_a_learned_part_takes_no_weights():
    with pytest.raises(UserError, match="Linear has no learned part, but 3 weights"):
        Linear().with_weights(np.zeros(3))
    with pytest.raises(UserError, match="a network weight is not finite"):
        structure("hybrid").with_weights(np.full(30, np.nan)).check()


def test_values_go_in_and_out_by_name():
    beam = CamBeam()
    values = beam.values + 1e-3
    moved = beam.with_values(values)
    np.testing.assert_array_equal(moved.values, values)
    assert moved.named["gain"] == beam.gain + 1e-3
    assert moved.delay == beam.input_delay + 1e-3
