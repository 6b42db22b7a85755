"""The winged cone: published equilibria, poles and slopes, its autopilot, and what its records tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from benchmarks.winged_cone import autopilot, control, flights
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.shared.feedback_resimulation import follow_again
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.experiments import driven, excitation
from hybrid_sysid_ros.rigs.experiments import simulate_experiment as record_of
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.winged_cone.system import engine, sound
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError

SPEED, PATH, HEIGHT, ANGLE, PITCH, THROTTLE, THROTTLE_RATE = range(7)
LEVEL = {"speed": 0.0, "height": 0.0}
DEGREE = np.pi / 180.0


@pytest.fixture(scope="module")
def rig():
    return rigs.load("winged_cone")


def equilibrium(*given):
    """Of a system; without its extension the test is skipped."""
    return pytest.importorskip("hybrid_sysid_ros.extensions.trim.equilibrium").equilibrium(*given)


def forms(rig):
    """The four of the published rows."""
    return {
        "frozen": rig.structures["constant_air"],
        "known air": rig.structures["known_air"],
        "without lift of the elevator": replace(rig.system, elevator_lift=0.0),
        "vehicle": rig.system,
    }


ROWS = {  # angle of attack [deg], throttle, elevator [deg], pitch's poles, slow real pole, slow pair
    "frozen": (1.7891, 0.17619, -0.3979, 0.71486, -0.82706, 0.0, -1e-6, 0.00251),
    "known air": (1.7892, 0.17619, -0.3979, 0.71489, -0.82702, 0.0, -3.3e-5, 0.02954),
    "without lift of the elevator": (1.7891, 0.17619, -0.3980, 0.71476, -0.82734, 4.6e-4, -3.3e-5, 0.02757),
    "vehicle": (1.7705, 0.17562, -0.3947, 0.71644, -0.82900, 4.5e-4, -3.2e-5, 0.02760),
}
"""Computed by others from the published equations."""


@pytest.mark.parametrize("row", ROWS)
def test_it_flies_level_where_published_and_its_modes_are_those(rig, row):
    angle, throttle, elevator, unstable, stable, real, decay, swing = ROWS[row]
    system = forms(rig)[row]
    found, point = equilibrium(system, LEVEL), system.operating_point
    assert np.degrees(found.states[ANGLE] + point["angle_of_attack"]) == pytest.approx(angle, abs=5.1e-5)
    assert found.inputs[0] + point["throttle_command"] == pytest.approx(throttle, abs=2e-5)
    assert found.states[THROTTLE] == pytest.approx(found.inputs[0])
    assert np.degrees(found.inputs[1] + point["elevator"]) == pytest.approx(elevator, abs=5.1e-5)
    modes = pytest.importorskip("hybrid_sysid_ros.extensions.trim.modes")
    known = modes.named_modes(rig)
    named: dict[str, list[complex]] = {}
    for mode in found.modes:
        named.setdefault(modes.mode_name(mode, system, known), []).append(mode.pole)
    assert sorted(pole.real for pole in named["short_period"]) == pytest.approx([stable, unstable], abs=2e-5)
    assert named["engine"] == [pytest.approx(20.0 * complex(-0.7, np.sqrt(1.0 - 0.7**2)))]
    assert named["height"] == [pytest.approx(real, abs=1e-5)]
    assert named["phugoid"][0].real == pytest.approx(decay, abs=1e-6)
    assert named["phugoid"][0].imag == pytest.approx(swing, abs=1e-5)


def test_where_it_is_valid_its_speed_of_sound_is_that_of_the_standard_atmosphere(rig):
    """Layers of 1976: heights [m] where the slope of the temperature [K] changes; 1.4 and 287.05 J/kg K."""
    low, high = rig.validity[:, HEIGHT] + rig.system.operating_point["height"]
    heights = np.linspace(low, high, 200)
    geopotential = 6_356_766.0 * heights / (6_356_766.0 + heights)
    corners = [288.15, 216.65, 216.65, 228.65, 270.65, 270.65]
    kelvin = np.interp(geopotential, [0.0, 11e3, 20e3, 32e3, 47e3, 51e3], corners)
    np.testing.assert_allclose(sound(heights), np.sqrt(1.4 * 287.05287 * kelvin), rtol=0.015)
    speeds = rig.validity[:, SPEED] + rig.system.operating_point["speed"]
    np.testing.assert_allclose(speeds / sound(rig.system.operating_point["height"]), [5.0, 25.0], atol=0.01)


def test_the_origin_is_level_flight_of_the_frozen_model(rig):
    found = equilibrium(rig.structures["constant_air"], LEVEL)
    np.testing.assert_allclose([*found.states, *found.inputs], 0.0, atol=2e-8)


def test_the_frozen_model_has_the_published_slopes(rig):
    found = equilibrium(rig.structures["constant_air"], LEVEL)
    slopes = {
        (SPEED, PATH): -9.59473, (SPEED, ANGLE): -14.46431, (PATH, SPEED): 9.10715e-7, (PATH, ANGLE): 0.0439867,
        (HEIGHT, PATH): 4590.29, (ANGLE, SPEED): -9.10715e-7, (ANGLE, ANGLE): -0.0439867, (ANGLE, PITCH): 1.0,
        (PITCH, ANGLE): 0.594215, (PITCH, PITCH): -0.0682187, (SPEED, THROTTLE): 8.32012, (PATH, THROTTLE): 5.66e-5,
    }  # fmt: skip
    for (row, column), expected in slopes.items():
        assert found.transition[row, column] == pytest.approx(expected, rel=2e-5 if expected > 1e-3 else 2e-3)
    assert found.gain[PITCH, 1] == pytest.approx(3.316867, rel=1e-5)
    vehicle = equilibrium(rig.system, LEVEL)
    assert vehicle.gain[PATH, 1] == pytest.approx(-0.0020765, rel=5e-3)
    assert vehicle.gain[ANGLE, 1] == -vehicle.gain[PATH, 1]


def test_at_mach_15_the_vehicle_s_coefficients_are_the_frozen_ones(rig):
    """To the four digits of the source; elevator's lift and loss of thrust are what the frozen ones lack."""
    frozen, vehicle = rig.structures["known_air"], replace(rig.system, elevator_lift=0.0, thrust_loss=0.0)
    height = 33_528.0
    speed = 15.0 * (2.9495e-8 * height**2 - 9.16e-4 * height + 303.5808)
    for a in np.radians([0.5, 1.8, 4.0]):
        forces = [[float(value) for value in system.forces(speed, height, a, 0.0)] for system in (frozen, vehicle)]
        np.testing.assert_allclose(forces[0], forces[1], rtol=1e-3)
        for q in (0.0, 0.05):
            one, other = (float(system.moment(speed, height, a, q)) for system in (frozen, vehicle))
            assert one == pytest.approx(other, rel=2e-3, abs=2e-7)


def test_thrust_goes_on_where_the_throttle_passes_1_and_is_lost_at_large_angles(rig):
    def thrust(a, b):
        return float(rig.system.forces(4590.29, 33_528.0, np.radians(a), 0.0)[2] * engine(b))

    for b, published in ((0.2, 0.02576 * 0.2), (0.9, 0.02576 * 0.9), (1.5, 0.0224 + 0.00336 * 1.5)):
        assert float(rig.structures["constant_air"].forces(0.0, 0.0, 0.0, 0.0)[2] * engine(b)) == pytest.approx(
            published, rel=1e-3
        )
    assert thrust(1.8, 1.0 - 1e-9) == pytest.approx(thrust(1.8, 1.0 + 1e-9))
    assert thrust(4.8, 0.5) / thrust(1.8, 0.5) == pytest.approx(0.56, abs=0.01)
    assert abs(thrust(6.3, 0.5)) < 0.01 * thrust(1.8, 0.5)


def test_the_engine_answers_a_step_as_its_equation_says(rig):
    """b(t) = 1 - exp(-z w t) (cos wd t + z w / wd sin wd t)."""
    states = simulate(rig.system, np.zeros(7), np.tile([0.1, 0.0], (60, 1)), step=rig.step)
    time, w, z = rig.step * np.arange(61), 20.0, 0.7
    wd = w * np.sqrt(1.0 - z * z)
    expected = 0.1 * (1.0 - np.exp(-z * w * time) * (np.cos(wd * time) + z * w / wd * np.sin(wd * time)))
    np.testing.assert_allclose(states[:, THROTTLE], expected, atol=1e-6)


def discrete(a, b, period):
    """A and B under inputs that hold."""
    n, m = b.shape
    both = expm(period * np.block([[a, b], [np.zeros((m, n + m))]]))
    return both[:n, :n], both[:n, n:]


def regulator(a, b, q, r):
    p = solve_discrete_are(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


def rigid(rig):
    """The frozen model with the engine at rest: V g h a q by throttle and elevator."""
    found = equilibrium(rig.structures["constant_air"], LEVEL)
    return found.transition[:5, :5], np.column_stack([found.transition[:5, THROTTLE], found.gain[:5, 1]])


def test_the_stabiliser_is_the_regulator_of_pitch(rig):
    a, b = rigid(rig)
    pitch = [ANGLE, PITCH]
    a, b = discrete(a[np.ix_(pitch, pitch)], b[pitch][:, 1:], 0.02)
    gains = regulator(a, b, np.eye(2) / DEGREE**2, np.eye(1) / (2.0 * DEGREE) ** 2)
    np.testing.assert_allclose(rig.experiments.stabiliser[1, pitch], gains[0], rtol=1e-4)
    assert np.count_nonzero(rig.experiments.stabiliser) == 2


def test_the_autopilot_is_the_regulator_with_integrals_of_speed_and_height(rig):
    a, b = rigid(rig)
    integrals = np.zeros((2, 5))
    integrals[0, SPEED] = integrals[1, HEIGHT] = 1.0
    a = np.block([[a, np.zeros((5, 2))], [integrals, np.zeros((2, 2))]])
    a, b = discrete(a, np.vstack([b, np.zeros((2, 2))]), 0.02)
    q = 1.0 / np.array([10.0, 0.2 * DEGREE, 100.0, DEGREE, DEGREE, 200.0, 2000.0]) ** 2
    gains = regulator(a, b, np.diag(q), np.diag(1.0 / np.array([0.2, 2.0 * DEGREE]) ** 2))
    feedback = rig.experiments.feedback
    np.testing.assert_allclose(feedback.gains, gains[:, :5], rtol=2e-3)
    np.testing.assert_allclose(feedback.integral, gains[:, 5:], rtol=2e-3)


def test_what_the_autopilot_adds_for_its_commands_is_what_the_frozen_model_needs(rig):
    """Along a motion of speed and height with constant second derivatives, states and inputs of the reference leave the
    linear model's equations of V, g, h, a and q at rest.
    """
    a, b = rigid(rig)
    feedback = rig.experiments.feedback
    for followed in (0, 1):
        rate, acceleration = feedback.wanted[:, 3 * followed + 1], feedback.wanted[:, 3 * followed + 2]
        value = feedback.wanted[:, 3 * followed]
        for term, before in ((rate, value), (acceleration, rate)):
            forward = feedback.forward[:, 3 * followed + (1 if term is rate else 2)]
            scale = np.array([1.0, 1e-4, 1.0, 1e-4, 1e-4])
            np.testing.assert_allclose((a @ term + b @ forward - before) / scale, 0.0, atol=0.08)


@pytest.mark.parametrize(("name", "longest", "overshoot"), [("speed", 40.0, 0.3048), ("height", 57.0, 6.096)])
def test_the_autopilot_settles_in_time_without_overshoot(rig, name, longest, overshoot):
    """On the vehicle with nominal numbers, with noise: 38.9 s and 55.9 s were published."""
    step = autopilot.STEPS[name]
    flight = flights.fly(rig, rig.system, flights.steps(rig, {name: step}, 90.0), seed=0).since(flights.SETTLING)
    settling, over = autopilot.judged(flight.time, flight.states[:, autopilot.STATES[name]], step)
    assert settling == pytest.approx({"speed": 38.9, "height": 55.9}[name], abs=0.6)
    assert settling <= longest
    assert over < overshoot


def test_compiled_flights_are_those_of_the_simulated_rig(rig):
    signals = flights.experiment(rig, "flight", 1, 4.0)
    flight = flights.fly(rig, rig.system, signals)
    plant = Plant(rig, seed=0, noisy=False)
    times = rig.step * np.arange(round(4.0 / rig.step) + 1)
    wanted = excitation(rig, "flight", seed=1, duration=4.0, times=times)
    applied = np.array(list(driven(plant, wanted[:-1])))
    np.testing.assert_allclose(flight.states[-1], plant.state, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(flight.inputs, applied.reshape(-1, 4, 2).mean(axis=1), rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_a_bag_of_a_flight_has_commands_and_is_flown_again_by_the_vehicle_itself(rig, tmp_path: Path):
    """Without noise and with all that was added to the inputs."""
    quiet = replace(rig, sensors=tuple(replace(sensor, white_noise=0.0) for sensor in rig.sensors))
    folder = record_of(quiet, "climbs", tmp_path / "climb", seed=2, duration=75.0, rate=50.0)
    record = bags.read(folder, rig.signals)
    assert record.channels["reference_height"].max() == pytest.approx(800.0)
    again = follow_again(rig.system, record, rig, sampling=Sampling(step=0.005, period=0.02))
    deviation = np.std(record.output, axis=0)
    np.testing.assert_allclose((again.outputs - record.output) / deviation, 0.0, atol=2e-3)
    assert again.scores.r2 > 0.999
    assert np.max(record.input[:, 0]) > 0.9  # throttle of 1.1 in all during the climb
    slow = replace(record, time=record.time[::2], input=record.input[::2], output=record.output[::2], channels={})
    with pytest.raises(UserError, match=r"sampled every 0\.04 s, the feedback works every 0\.02 s"):
        follow_again(rig.system, slow, rig, sampling=Sampling(step=0.02, period=0.04))


def test_the_quasi_steady_engine_is_the_engine_where_it_was_told_to_be(rig):
    random = np.random.default_rng(0)
    for _ in range(20):
        x, u = random.normal(size=5) * [30.0, 0.01, 500.0, 0.02, 0.02], random.uniform(-0.1, 1.0, 2) * [1.0, 0.2]
        whole = rig.structures["known_air"].law([*x, u[0], 0.0], u)
        quick = rig.structures["known_air_quasi_steady"].law(x, u)
        np.testing.assert_allclose(np.array(quick, dtype=float), np.array(whole[:5], dtype=float), rtol=1e-14)


@pytest.fixture(scope="module")
def shipped(rig):
    return load_model(configuration.shipped(rig.name, "model"))


@pytest.mark.parametrize("number", [0, 63, 500])
def test_the_mpc_flies_both_steps_on_plants_it_does_not_know(rig, shipped, number):
    """Two opposite corners of what is uncertain, and one between."""
    plant = replace(rig, system=control.plant(rig.system, number))
    found = control.measures(rig, control.flown(plant, shipped, control.mpc_of(rig, shipped), seed=number))
    reported = dict(zip(control.MEASURES, found, strict=True))
    assert reported["speed settling"] <= 25.0
    assert reported["height settling"] <= 33.0
    assert reported["highest angle"] <= 4.8
    assert reported["speed final"] < 0.3
    assert reported["height final"] < 3.0
    assert reported["failed"] == reported["not converged"] == 0


def test_the_corners_are_all_there(rig):
    found = {tuple(control.plant(rig.system, k).values[:6].tolist()) for k in range(64)}
    assert len(found) == 64
    bounds = [(item.low, item.high) for item in rig.system.parameters[:6]]
    assert all(value in pair for corner in found for value, pair in zip(corner, bounds, strict=True))
