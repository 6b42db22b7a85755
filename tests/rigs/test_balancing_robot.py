"""The balancing robot: its equations against a derivation in the world's coordinates, its gains, and its stand."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi
import numpy as np
import pytest
from scipy import linalg

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.core import simulate, step_with_jacobian
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.experiments import driven
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.simulated_loop import simulated_loop

M, WHEEL, R, TRACK, DEPTH, TALL, G = 0.6, 0.03, 0.04, 0.14, 0.04, 0.144, 9.81
"""Body and wheel [kg], radius, track, depth and height [m] of the NXTway-GS (Yamamoto 2008)."""
LOOSE = ("tilt_inertia", "yaw_inertia", "rounding")
"""What the records leave open by more than a tenth."""
PUSH = 0.3
"""On the centre of the body [N s]."""


@pytest.fixture(scope="module")
def rig():
    return rigs.load("balancing_robot")


@pytest.fixture(scope="module")
def smooth(rig):
    """The robot without dead zone and dry friction."""
    return replace(rig.system, dead_zone=0.0, coulomb=0.0)


@cache
def derived(height, tilt_inertia, yaw_inertia, drive_inertia):
    """Accelerations (x, y, yaw, tilt, two wheels), kinetic energy and potential, from coordinates q (6,) and their
    rates: Lagrange's equations with multipliers for wheels that roll and do not slip sideways.
    """
    q, rates, torques = casadi.SX.sym("q", 6), casadi.SX.sym("rates", 6), casadi.SX.sym("torques", 2)
    x, y, yaw, tilt = casadi.vertsplit(q)[:4]
    ahead = casadi.vertcat(casadi.cos(yaw), casadi.sin(yaw), 0.0)
    aside = casadi.vertcat(-casadi.sin(yaw), casadi.cos(yaw), 0.0)
    centre = casadi.vertcat(x, y, R) + height * (casadi.sin(tilt) * ahead + casadi.vertcat(0, 0, casadi.cos(tilt)))
    drive = drive_inertia - 0.5 * WHEEL * R**2

    def speed_of(point):
        return casadi.jtimes(point, q, rates)

    turn, lean = rates[2], rates[3]
    axes = casadi.vertcat(-turn * casadi.sin(tilt), lean, turn * casadi.cos(tilt))  # of the body: ahead, aside, up
    inertias = casadi.vertcat(M * (TRACK**2 + TALL**2) / 12, tilt_inertia, yaw_inertia)
    kinetic = 0.5 * M * casadi.sumsqr(speed_of(centre)) + 0.5 * casadi.dot(inertias, axes**2)
    for side, rate in ((1.0, rates[4]), (-1.0, rates[5])):
        hub = casadi.vertcat(x, y, R) + 0.5 * side * TRACK * aside
        kinetic += 0.5 * WHEEL * casadi.sumsqr(speed_of(hub)) + 0.25 * WHEEL * R**2 * (rate**2 + 0.5 * turn**2)
        kinetic += 0.5 * drive * (rate - lean) ** 2  # the rotor turns against the body
    potential = M * G * height * casadi.cos(tilt)
    axle, apart = speed_of(casadi.vertcat(x, y, 0)), 0.5 * TRACK * turn
    forward = casadi.dot(ahead, axle)
    rolling = casadi.vertcat(casadi.dot(aside, axle), forward - apart - R * rates[4], forward + apart - R * rates[5])
    held = casadi.jacobian(rolling, rates)
    mass = casadi.hessian(kinetic, rates)[0]
    momentum = casadi.gradient(kinetic, rates)
    forces = casadi.gradient(kinetic - potential, q) - casadi.jtimes(momentum, q, rates)
    forces += casadi.vertcat(0, 0, 0, -torques[0] - torques[1], torques[0], torques[1])
    matrix = casadi.blockcat([[mass, held.T], [held, casadi.SX(3, 3)]])
    found = casadi.solve(matrix, casadi.vertcat(forces, -casadi.jtimes(held @ rates, q, rates)))
    return casadi.Function("derived", [q, rates, torques], [found[:6], kinetic + potential])


def whole(state):
    """Coordinates and rates (6,) each of a state: tilt, yaw, speed, tilt rate, yaw rate."""
    tilt, yaw, speed, lean, turn = state
    wheels = (speed - 0.5 * TRACK * turn) / R, (speed + 0.5 * TRACK * turn) / R
    q = np.array([0.0, 0.0, yaw, tilt, 0.0, 0.0])
    return q, np.array([speed * np.cos(yaw), speed * np.sin(yaw), turn, lean, *wheels])


def derivation(system):
    return derived(*(system.named[name] for name in ("height", "tilt_inertia", "yaw_inertia", "drive_inertia")))


def rates_by_derivation(system, state, counts):
    """Rates (5,) of a state by the derivation and the motor's equation, without a delay."""
    q, rates = whole(state)
    torques = []
    for wheel, u in zip(rates[4:] - rates[3], counts, strict=True):
        corners = [np.hypot(u + s * system.dead_zone, system.rounding) for s in (1.0, -1.0)]
        driven_speed = system.gain * (u - 0.5 * (corners[0] - corners[1]))
        friction = system.coulomb * np.tanh(wheel / 0.2)
        torques.append(system.drive_inertia / system.time_constant * (driven_speed - wheel - friction))
    found = np.array(derivation(system)(q, rates, torques)[0]).ravel()
    ahead = found[0] * np.cos(q[2]) + found[1] * np.sin(q[2])  # of the acceleration, the part along the heading
    return np.array([state[3], state[4], ahead, found[3], found[2]])


def test_its_law_is_lagranges_with_rolling_wheels(rig):
    random = np.random.default_rng(0)
    for _ in range(20):
        state, counts = random.uniform(-1.0, 1.0, 5) * [1.0, 3.0, 1.0, 5.0, 6.0], random.uniform(-255.0, 255.0, 2)
        expected = rates_by_derivation(rig.system, state, counts)
        found = [float(value) for value in rig.system.law(state.tolist(), counts.tolist())]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_without_friction_and_drive_its_energy_stays(rig):
    """For a second from a lean, with speed and yaw rate; motors whose time constant is endless have no torque."""
    free = replace(rig.system, time_constant=1e12)
    states = simulate(free, np.array([0.3, 0.5, 0.4, -1.0, 4.0]), np.zeros((1000, 2)), step=1e-3)
    energy = np.array([float(derivation(free)(*whole(state), [0.0, 0.0])[1]) for state in states[::50]])
    assert np.ptp(states[:, 0]) > 0.5
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)


def linear(system):
    """A (3, 3) and b (3,) of tilt, speed and tilt rate at rest, by both motors together, from the derivation."""
    kept, step = [0, 2, 3], 1e-6

    def ahead(state, counts):
        return rates_by_derivation(system, np.array(state), [counts, counts])[kept]

    rows = np.eye(5)[kept] * step
    a = np.column_stack([(ahead(row, 0.0) - ahead(-row, 0.0)) / (2 * step) for row in rows])
    return a, (ahead(np.zeros(5), 1.0) - ahead(np.zeros(5), -1.0)) / 2.0


def test_its_poles_are_those_of_the_derivation(smooth):
    """And one is unstable: upright, an error grows by e in .137 s."""
    expected = np.linalg.eigvals(linear(smooth)[0])
    assert np.max(expected.real) == pytest.approx(1 / 0.137, rel=5e-3)
    transition = step_with_jacobian(smooth, np.zeros(5), np.zeros(2), step=1e-3)[1][:, :5]
    found = np.log(np.linalg.eigvals(transition[np.ix_([0, 2, 3], [0, 2, 3])])) / 1e-3
    np.testing.assert_allclose(np.sort(found.real), np.sort(expected.real), rtol=1e-6)


def test_its_motors_are_those_of_the_wheel_motor(rig):
    wheel = rigs.load("wheel_motor").system.named
    assert {name: rig.system.named[name] for name in wheel} == wheel


def test_its_gains_are_a_regulators(rig, smooth):
    """Of tilt, speed and tilt rate at 100 Hz: deviations of .1 rad, .3 m/s, 1.5 rad/s, and 100 counts of each motor."""
    a, b = linear(smooth)
    held = linalg.expm(np.block([[a, b[:, None]], [np.zeros((1, 4))]]) * 0.01)[:3]
    a, b = held[:, :3], held[:, 3:]
    costs = np.diag(np.array([0.1, 0.3, 1.5]) ** -2.0)
    cost = np.array([[100.0**-2.0]])
    riccati = linalg.solve_discrete_are(a, b, costs, cost)
    gains = np.linalg.solve(cost + b.T @ riccati @ b, b.T @ riccati @ a)[0]
    names = [item.name for item in rig.system.outputs]
    columns = [names.index(name) for name in ("tilt", "speed", "tilt_rate")]
    for row in rig.experiments.stabiliser[:, columns]:
        np.testing.assert_allclose(row, gains, rtol=2e-3)
    np.testing.assert_array_equal(rig.experiments.feedback.gains[:, columns], rig.experiments.stabiliser[:, columns])


class Pushed(Plant):
    """The simulated robot, whose body gets a push on its centre 2 s after the beginning."""

    def advance(self, inputs):
        super().advance(inputs)
        if round(self.time / self.step) == 2000:
            told, lean = self.rig.system.named, float(np.cos(self.state[0]))
            rotors, moment = 2.0 * (told["drive_inertia"] - 0.5 * WHEEL * R**2), M * told["height"]
            coupling, inertia = moment * lean - rotors / R, moment * told["height"] + told["tilt_inertia"] + rotors
            mass = np.array([[M + 2 * WHEEL + 2 * told["drive_inertia"] / R**2, coupling], [coupling, inertia]])
            self.state[2:4] += np.linalg.solve(mass, np.array([PUSH, PUSH * lean * told["height"]]))


def test_its_feedback_stands_up_to_a_push(rig):
    """A push of .3 N s on the centre of the body, through the sensors, the bridge and its delay."""
    plant = Pushed(rig, seed=3)
    tilt = np.array([plant.state[0] for _ in driven(plant, np.zeros((6000, 4)))])
    assert plant.stopped == 0
    assert np.max(np.abs(tilt)) < np.radians(12.0)
    assert np.max(np.abs(tilt[5000:])) < np.radians(3.0)


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_the_mpc_on_the_shipped_model_stands_up_to_a_push(rig, speed):
    """At rest and at .3 m/s, to which it returns; the estimator does not take the push for an outlier."""
    model = load_model(configuration.shipped(rig.name, "model"))
    system = configuration.controller_model(rig, model.system)
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig, model.system)
    controller = configuration.wrap_for_rig(rig, system, ExactMpc(system, problem))
    plant = Pushed(rig, seed=3)

    def wanted(times):
        return np.tile([speed, 0.0, 0.0, 0.0, 0.0], (len(times), 1))

    loop = simulated_loop(rig, model, controller, wanted, duration=5.0, plant=plant)
    assert plant.stopped == 0
    assert np.max(np.abs(loop.states[:, 0])) < np.radians(20.0)
    assert np.max(np.abs(loop.states[450:, 2] - speed)) < 0.03


def test_the_shipped_model_knows_the_rig(rig):
    """Within a tenth; what the records leave open, within a quarter."""
    model = load_model(configuration.shipped(rig.name, "model"))
    for name, value in model.system.named.items():
        assert value == pytest.approx(rig.system.named[name], rel=0.25 if name in LOOSE else 0.1), name


def test_the_shipped_policy_belongs_to_rig_and_model(rig):
    model = load_model(configuration.shipped(rig.name, "model"))
    shipped = policy.load(configuration.shipped(rig.name, "policy"), model=model)
    values = configuration.defaults(rig.name, "controller")
    assert shipped.problem.sized(model.system) == configuration.mpc_problem(values, rig, model.system)
    assert shipped.certificate is not None
