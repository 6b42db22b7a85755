"""Every estimator: the textbook filter on linear models, what it makes of the beam's sensor, and other models."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.estimation import estimator_class
from hybrid_sysid_ros.rigs.excitation import multisine
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_estimation import HUM, LINEAR, PERIOD, QUIET


def matrices(system, h):
    """Textbook form of one step of the linear model with its input disturbance, z = [q, v, d]: z+ = F z + b."""
    half = 0.5 * h * system.damping  # trapezoidal damping
    velocity = np.array([-h * system.stiffness, 1 - half, h * system.gain]) / (1 + half)
    transition = np.array([np.array([1.0, 0.0, 0.0]) + h * velocity, velocity, [0.0, 0.0, 1.0]])
    return transition, h * system.gain / (1 + half) * np.array([h, 1.0, 0.0])


class TextbookFilter:
    """Kalman (1960): predict and correct, the covariance in its plain form."""

    def __init__(self, system, tuning, state, covariance, h):
        self.f, self.b = matrices(system, h)
        self.centre = system.centre
        self.q = h * np.diag([*tuning.process_noise, *tuning.disturbance_noise]) ** 2
        self.r = tuning.measurement_noise[0] ** 2
        self.z, self.p = state, covariance

    def predict(self, u):
        self.z = self.f @ self.z + self.b * (u - self.centre)
        self.p = self.f @ self.p @ self.f.T + self.q

    def correct(self, y):
        s = self.p[0, 0] + self.r
        gain = self.p[:, 0] / s
        innovation = y - self.z[0]
        self.z = self.z + gain * innovation
        self.p = self.p - np.outer(gain, gain) * s
        return innovation, innovation**2 / s


def test_on_a_linear_model_it_is_the_textbook_filter(kind):
    random = np.random.default_rng(0)
    ours = kind(LINEAR, QUIET, period=PERIOD)
    first = ours.update(0.0, np.array([0.01]), np.zeros(1))
    textbook = TextbookFilter(LINEAR, QUIET, np.array([0.01, 0.0, 0.0]), first.covariance[:3, :3], PERIOD)
    for k in range(1, 600):
        u, y = random.uniform(-5, 5), random.normal() * 0.05
        textbook.predict(u)
        if k % 7 == 3:  # no number: predicted over
            estimate = ours.update(k * PERIOD, np.array([np.nan]), np.array([u]))
        else:
            innovation, normalised = textbook.correct(y)
            estimate = ours.update(k * PERIOD, np.array([y]), np.array([u]))
            assert estimate.innovation[0] == pytest.approx(innovation, rel=1e-6, abs=1e-12)
            assert estimate.normalised_innovation == pytest.approx(normalised, rel=1e-6)
        np.testing.assert_allclose(estimate.state, textbook.z[:2], rtol=1e-6, atol=1e-10)
        np.testing.assert_allclose(estimate.disturbance, textbook.z[2:], rtol=1e-6, atol=1e-10)
        np.testing.assert_allclose(estimate.covariance[:3, :3], textbook.p, rtol=1e-6, atol=1e-14)


def test_measurements_seconds_apart_are_predicted_over_in_steps_of_the_model(kind):
    period = 400 * PERIOD
    ours = kind(LINEAR, QUIET, period=period)
    first = ours.update(0.0, np.array([0.0]), np.zeros(1))
    textbook = TextbookFilter(LINEAR, QUIET, np.zeros(3), first.covariance[:3, :3], PERIOD)
    for k in range(1, 3):
        for _ in range(400):
            textbook.predict(3.0)
        textbook.correct(0.02)
        estimate = ours.update(k * period, np.array([0.02]), np.array([3.0]))
        np.testing.assert_allclose(estimate.state, textbook.z[:2], rtol=1e-5, atol=1e-8)


def test_a_gap_is_predicted_over_in_steps_of_the_model(kind):
    ours = kind(LINEAR, QUIET, period=PERIOD)
    first = ours.update(0.0, np.array([0.0]), np.zeros(1))
    textbook = TextbookFilter(LINEAR, QUIET, np.zeros(3), first.covariance[:3, :3], PERIOD)
    for _ in range(8):
        textbook.predict(3.0)
    textbook.correct(0.02)
    estimate = ours.update(8 * PERIOD, np.array([0.02]), np.array([3.0]))
    np.testing.assert_allclose(estimate.state, textbook.z[:2], rtol=1e-6)
    np.testing.assert_allclose(estimate.covariance[:3, :3], textbook.p, rtol=1e-6, atol=1e-14)
    assert ours.counters.missing == 7


@pytest.mark.parametrize("tuning", [QUIET, HUM], ids=["plain", "hum"])
def test_innovations_of_a_rig_as_noisy_as_stated_are_white_with_their_variance(kind, tuning):
    """Sum of N normalised squares within the chi-square band of N degrees of freedom, lag-one correlation about 0."""
    samples, rejected = 4000, 0
    for seed in range(4):
        random = np.random.default_rng(seed)
        ours = kind(LINEAR, tuning, period=PERIOD)
        f, b = matrices(LINEAR, PERIOD)
        deviations = np.sqrt(PERIOD) * np.array([*tuning.process_noise, *tuning.disturbance_noise])
        turn = 2 * np.pi * tuning.hum_hertz[0] * PERIOD
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        z, hum = np.zeros(3), tuning.hum_amplitude[0] * random.normal(size=2)
        u, squares, innovations = 0.0, [], []
        for k in range(samples + 200):
            y = z[0] + hum[0] + tuning.measurement_noise[0] * random.normal()
            estimate = ours.update(k * PERIOD, np.array([y]), np.array([u]))
            squares.append(estimate.normalised_innovation)
            innovations.append(estimate.innovation[0])
            u = random.uniform(-5, 5)
            z = f @ z + b * (u - LINEAR.centre) + deviations * random.normal(size=3)
            hum = rotation @ hum + np.sqrt(PERIOD) * tuning.hum_noise[0] * random.normal(size=2)
        low, high = chi2.ppf([0.005, 0.995], samples)
        rejected += not low <= np.sum(squares[200:]) <= high
        white = np.array(innovations[200:])
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4 / np.sqrt(samples)
    assert rejected == 0


def loop(kind, rig, *, seconds=20.0, period=PERIOD, seed=0, bias=0.0, noisy=True, latency=0.0):
    """The beam on a multisine under its P controller, watched by the filter as it is shipped."""
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    ours = kind(rig.system, tuning, period=period, latency=latency)
    plant = Plant(rig, seed=seed, bias=bias, noisy=noisy)
    reference = multisine(1, amplitude=4.0, low=0.1, high=1.5, lines=15, period=10.0)
    scale, u = rig.display[0].scale, 0.0
    fine, estimates, raw = [plant.state.copy()], [], []
    for _ in range(round(seconds / period)):
        measured = plant.measure()
        estimates.append(ours.update(measured.time, measured.outputs, np.array([u])))
        raw.append(measured.outputs[0])
        u = float(np.clip(3 * (reference(measured.time) - measured.filtered[0] / scale), -10, 10))
        for _ in range(round(period / rig.step)):
            plant.advance(u)
            fine.append(plant.state.copy())
    return ours, estimates, np.array(raw), np.array(fine)


@pytest.fixture(scope="module")
def watched(kind, rig):
    return loop(kind, rig, bias=0.3)


def test_the_hum_is_taken_out_of_the_position(watched, rig):
    _, estimates, raw, fine = watched
    truth = fine[:: round(PERIOD / rig.step), 0][: len(raw)]
    settled = slice(200, None)
    error = np.sqrt(np.mean(([e.state[0] for e in estimates] - truth)[settled] ** 2))
    noise = np.sqrt(np.mean((raw - truth)[settled] ** 2))
    assert rig.display[0].shown(noise) == pytest.approx(0.052, rel=0.05)
    assert error < noise / 3


def test_the_disturbance_converges_to_the_bias_of_the_drive(watched):
    _, estimates, _, _ = watched
    assert np.mean([e.disturbance[0] for e in estimates[1000:]]) == pytest.approx(0.3, abs=0.02)


def test_on_the_beam_it_is_not_more_certain_than_it_may_be(watched):
    """Its process noise allows for an unknown beam, so on the known one the innovations are smaller, not larger."""
    _, estimates, _, _ = watched
    squares = [e.normalised_innovation for e in estimates[200:]]
    assert 0.5 < np.mean(squares) < chi2.ppf(0.995, len(squares)) / len(squares)


def test_numbers_that_no_rig_has_leave_a_finite_estimate(kind, rig):
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    ours = kind(rig.system, tuning, period=PERIOD, latency=0.001)
    for k, u in enumerate([0.0, 1.0, 1e300, -1e308, 1e200, 1.0, 1.0, 1.0]):
        estimate = ours.update(k * PERIOD, np.array([0.01]), np.array([u]))
        for value in (estimate.state, estimate.ahead, estimate.disturbance, estimate.covariance):
            assert np.all(np.isfinite(value))
    with pytest.raises(UserError, match="stamped nan"):
        ours.update(np.nan, np.array([0.01]), np.ones(1))


def test_the_covariance_stays_symmetric_and_positive(kind, rig):
    ours, estimates, _, _ = loop(kind, rig, seed=2)
    assert ours.counters.updates == 4_000
    for estimate in estimates[::100]:
        p = estimate.covariance
        np.testing.assert_allclose(p, p.T, atol=1e-15)
        assert np.all(np.linalg.eigvalsh((p + p.T) / 2) > 0)


@pytest.mark.parametrize("latency", [0.0, 0.004])
def test_ahead_is_where_the_beam_will_be_when_the_command_acts(kind, rig, latency):
    """The command of the last sample holds over the latency here, so the plant may be asked a delay later."""
    system = dataclasses.replace(rig.system, input_delay=0.008)
    slow = dataclasses.replace(rig, system=system)
    _, estimates, _, fine = loop(kind, slow, noisy=False, latency=latency, seconds=10.0)
    per_sample = round(PERIOD / rig.step)
    later = round((system.delay + latency) / rig.step)
    ahead, now = [], []
    for k, estimate in enumerate(estimates[200:-10], start=200):
        truth = fine[k * per_sample + later]
        ahead.append(estimate.ahead - truth)
        now.append(estimate.state - truth)
    errors, uncompensated = np.sqrt(np.mean(np.square(ahead), axis=0)), np.sqrt(np.mean(np.square(now), axis=0))
    assert np.all(errors < uncompensated / 3)


def test_without_any_delay_ahead_is_now(kind):
    ours = kind(LINEAR, QUIET, period=PERIOD)
    ours.update(0.0, np.array([0.01]), np.zeros(1))
    estimate = ours.update(PERIOD, np.array([0.02]), np.ones(1))
    np.testing.assert_array_equal(estimate.ahead, estimate.state)


def test_ahead_on_a_linear_model_is_its_simulation(kind):
    system = dataclasses.replace(LINEAR, input_delay=0.010)
    ours = kind(system, QUIET, period=PERIOD)
    inputs = np.random.default_rng(0).uniform(-5, 5, 50)
    ours.update(0.0, np.array([0.0]), inputs[:1])
    for k, u in enumerate(inputs, start=1):
        estimate = ours.update(k * PERIOD, np.array([0.001 * k]), np.array([u]))
    known = inputs[-2:, None] + estimate.disturbance  # what was applied within the last 10 ms acts in the next 10 ms
    expected = simulate(LINEAR, estimate.state, known, step=PERIOD)[-1]
    np.testing.assert_allclose(estimate.ahead, expected, rtol=1e-9)


def test_hum_that_looks_like_a_position_counts_as_noise(kind, rig):
    """60 Hz sampled at 20 Hz stands still: no filter can tell it from the beam's angle."""
    tuning = dataclasses.replace(HUM, measurement_noise=(1e-4,))
    ours = kind(LINEAR, tuning, period=0.05)
    for k in range(200):
        estimate = ours.update(k * 0.05, np.array([2e-3]), np.array([LINEAR.centre]))
    innovation_variance = estimate.innovation[0] ** 2 / estimate.normalised_innovation
    assert innovation_variance > HUM.hum_amplitude[0] ** 2
    assert estimate.covariance.shape == (3, 3)


# Other models


def test_a_motor_of_three_states_shows_its_current(motor):
    """Current and load come out of the angle alone."""
    tuning = dataclasses.replace(QUIET, process_noise=(1e-4, 0.02, 0.02), disturbance_noise=(0.5,))
    ours = estimator_class("ukf")(motor, tuning, period=PERIOD)
    random = np.random.default_rng(0)
    x = np.zeros(3)
    u = 0.0
    for k in range(4000):
        estimate = ours.update(k * PERIOD, x[:1] + 5e-4 * random.normal(), np.array([u]))
        u = 6.0 * np.sign(np.sin(0.01 * k))
        x = simulate(motor, x, np.array([[u + 0.7]]), step=PERIOD)[-1]
    # The estimate is of the state one sample before x.
    assert estimate.disturbance[0] == pytest.approx(0.7, abs=0.1)
    assert estimate.ahead.shape == (3,)
    assert estimate.state[2] == pytest.approx(x[2], abs=0.15)
    assert estimate.state[1] == pytest.approx(x[1], abs=0.1)


def test_two_joints_are_told_from_the_link_alone(flexible_joint):
    tuning = dataclasses.replace(QUIET, process_noise=(1e-4, 1e-4, 0.5, 0.1), disturbance_noise=(0.01,))
    ours = estimator_class("mhe")(flexible_joint, tuning, period=PERIOD)
    random = np.random.default_rng(0)
    x, u, errors = np.zeros(4), 0.0, []
    for k in range(3000):
        estimate = ours.update(k * PERIOD, x[1:2] + 5e-4 * random.normal(), np.array([u]))
        errors.append(estimate.state - x)
        u = 0.8 * np.sign(np.sin(0.02 * k))
        x = simulate(flexible_joint, x, np.array([[u]]), step=PERIOD)[-1]
    position_error, speed_error = np.sqrt(np.mean(np.square(errors[500:]), axis=0))[[0, 2]]
    assert position_error < 0.01
    assert speed_error < 0.3
