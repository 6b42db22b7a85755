"""Closed loops of the exact MPC: at rest there is no offset, and motors and springs come to their set-points."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.closed_loop import simulate_loop
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter, Tuning
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.runtime import configuration
from tests.control.beam_problem import LINEAR, PROBLEM
from tests.straight_beam import straight


def test_there_is_no_offset_at_rest_under_a_constant_disturbance():
    """On the linear rig, to the last millivolt: the filter finds the bias and the MPC takes it away."""
    system = dataclasses.replace(LINEAR, input_delay=0.006)
    tuning = Tuning(
        measurement_noise=(5e-4,),
        process_noise=(1e-5, 0.3),
        disturbance_noise=(0.2,),
        disturbance_limit=(2.0,),
        hum_hertz=(0.0,),
        hum_amplitude=(0.0,),
        hum_noise=(0.0,),
        gate=1e6,
        patience=5,
    )
    estimator = ExtendedKalmanFilter(straight(system), tuning, period=0.02)
    controller = ExactMpc(system, PROBLEM)
    x, u, bias, target = np.zeros(2), 0.0, 0.6, 0.06
    past = [u] * 2
    for k in range(400):
        estimate = estimator.update(0.02 * k, x[:1], np.array([u]))
        u = float(
            controller.control(estimate.ahead, estimate.disturbance, np.array([u]), np.full((10, 1), target)).input[0]
        )
        past = [past[-1], u]
        # 6 ms of the input before, then the new one.
        held = np.array([past[0]] * 6 + [past[1]] * 14)[:, None] + bias
        x = simulate(LINEAR, x, held, step=0.001)[-1]
    assert x[0] == pytest.approx(target, abs=0.0227e-3)
    assert estimate.disturbance[0] == pytest.approx(bias, abs=0.05)


def test_the_noisy_beam_comes_to_rest_on_its_reference_despite_a_bias(rig):
    scale = rig.display[0].scale
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    loop = simulate_loop(
        Plant(rig, seed=0, bias=0.4),
        ExtendedKalmanFilter(rig.system, tuning, period=0.02),
        ExactMpc(rig.system, dataclasses.replace(PROBLEM, output_scales=(scale,))),
        lambda t: scale * np.where(np.asarray(t) < 2.0, 2.5, -1.0)[:, None],
        inputs=1,
        duration=4.0,
        period=0.02,
        lead=rig.system.delay,
    )
    volts = loop.outputs[:, 0] / scale
    assert np.mean(volts[75:95]) == pytest.approx(2.5, abs=0.06)
    assert np.mean(volts[-20:]) == pytest.approx(-1.0, abs=0.06)
    assert np.all(np.abs(loop.inputs) <= 10.0)
    assert loop.statuses[Status.SOLVED] == len(volts)


def settle(system, problem, target, output, seconds):
    """Where a model under its own MPC is after some seconds, and how fast."""
    controller = ExactMpc(system, problem)
    x, u = np.zeros(len(system.states)), np.zeros(1)
    for _ in range(round(seconds / problem.period)):
        u = controller.control(x, np.zeros(1), u, np.full((problem.horizon, 1), target)).input
        controller.prepare(problem.period)
        held = np.tile(u, (problem.substeps, 1))
        x = simulate(system, x, held, step=problem.period / problem.substeps)[-1]
    return x[output], x[-1]


def test_a_motor_of_three_states_is_turned_to_its_angle(motor):
    problem = dataclasses.replace(PROBLEM, horizon=20, period=0.05, output_scales=(1.0,), rate_weights=(0.1,))
    angle, current = settle(motor, problem, 2.0, 0, 6.0)
    assert angle == pytest.approx(2.0, abs=1e-3)
    assert current == pytest.approx(0.0, abs=1e-2)


def test_the_link_behind_a_spring_is_brought_to_its_angle(flexible_joint):
    """The measured joint is not the driven one, and the motor has dry friction."""
    problem = dataclasses.replace(
        PROBLEM, horizon=30, period=0.01, substeps=2, output_scales=(0.1,), input_low=(-3.0,), input_high=(3.0,)
    )
    angle, speed = settle(flexible_joint, problem, 0.5, 1, 3.0)
    assert angle == pytest.approx(0.5, abs=0.02)
    assert abs(speed) < 0.1
