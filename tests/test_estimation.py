"""Every estimator: the textbook filter on linear models, what it makes of the beam's sensor, and what goes wrong."""

import dataclasses
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.stats import chi2

from hybrid_sysid_ros import configuration
from hybrid_sysid_ros.equations import Variable, simulate
from hybrid_sysid_ros.errors import UserError
from hybrid_sysid_ros.estimation import METHODS, Tuning
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.rigs.excitation import multisine
from hybrid_sysid_ros.rigs.plant import Plant
from tests.straight_beam import straight

PERIOD = 0.005
LINEAR = straight(Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0))
QUIET = Tuning(
    measurement_noise=5e-4,
    process_noise=(1e-4, 0.2),
    disturbance_noise=0.05,
    disturbance_limit=1e3,
    hum_hertz=0.0,
    hum_amplitude=0.0,
    hum_noise=0.0,
    gate=1e9,
    patience=5,
)


def matrices(equation, h):
    """Textbook form of one step of the linear model with its input disturbance, z = [q, v, d]: z+ = F z + b."""
    half = 0.5 * h * equation.damping  # trapezoidal damping
    velocity = np.array([-h * equation.stiffness, 1 - half, h * equation.gain]) / (1 + half)
    transition = np.array([np.array([1.0, 0.0, 0.0]) + h * velocity, velocity, [0.0, 0.0, 1.0]])
    return transition, h * equation.gain / (1 + half) * np.array([h, 1.0, 0.0])


@pytest.fixture(scope="module", params=METHODS.values(), ids=list(METHODS))
def kind(request):
    return request.param


class TextbookFilter:
    """Kalman (1960): predict and correct, the covariance in its plain form."""

    def __init__(self, equation, tuning, state, covariance, h):
        self.f, self.b = matrices(equation, h)
        self.centre = equation.centre
        self.q = h * np.diag([*tuning.process_noise, tuning.disturbance_noise]) ** 2
        self.r = tuning.measurement_noise**2
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


HUM = dataclasses.replace(QUIET, hum_hertz=60.0, hum_amplitude=2e-3, hum_noise=1e-4)


@pytest.mark.parametrize("tuning", [QUIET, HUM], ids=["plain", "hum"])
def test_innovations_of_a_rig_as_noisy_as_it_is_told_are_white_with_their_variance(kind, tuning):
    """Sum of N normalised squares within the chi-square band of N degrees of freedom, lag-one correlation about 0."""
    samples, rejected = 4000, 0
    for seed in range(4):
        random = np.random.default_rng(seed)
        ours = kind(LINEAR, tuning, period=PERIOD)
        f, b = matrices(LINEAR, PERIOD)
        deviations = np.sqrt(PERIOD) * np.array([*tuning.process_noise, tuning.disturbance_noise])
        turn = 2 * np.pi * tuning.hum_hertz * PERIOD
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        z, hum = np.zeros(3), tuning.hum_amplitude * random.normal(size=2)
        u, squares, innovations = 0.0, [], []
        for k in range(samples + 200):
            y = z[0] + hum[0] + tuning.measurement_noise * random.normal()
            estimate = ours.update(k * PERIOD, np.array([y]), np.array([u]))
            squares.append(estimate.normalised_innovation)
            innovations.append(estimate.innovation[0])
            u = random.uniform(-5, 5)
            z = f @ z + b * (u - LINEAR.centre) + deviations * random.normal(size=3)
            hum = rotation @ hum + np.sqrt(PERIOD) * tuning.hum_noise * random.normal(size=2)
        low, high = chi2.ppf([0.005, 0.995], samples)
        rejected += not low <= np.sum(squares[200:]) <= high
        white = np.array(innovations[200:])
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4 / np.sqrt(samples)
    assert rejected == 0


def loop(kind, rig, *, seconds=20.0, period=PERIOD, seed=0, bias=0.0, noisy=True, latency=0.0):
    """The beam on a multisine under its P controller, watched by the filter as it is shipped."""
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    ours = kind(rig.equation, tuning, period=period, latency=latency)
    plant = Plant(rig, seed=seed, bias=bias, noisy=noisy)
    reference = multisine(1, amplitude=4.0, low=0.1, high=1.5, lines=15, period=10.0)
    scale, u = rig.sensor.radians_per_volt, 0.0
    fine, estimates, raw = [plant.state.copy()], [], []
    for _ in range(round(seconds / period)):
        measured = plant.measure()
        estimates.append(ours.update(measured.time, np.array([measured.position]), np.array([u])))
        raw.append(measured.position)
        u = float(np.clip(3 * (reference(measured.time) - measured.filtered / scale), -10, 10))
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
    assert rig.sensor.volts(noise) == pytest.approx(0.052, rel=0.05)
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
    ours = kind(rig.equation, tuning, period=PERIOD, latency=0.001)
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
    equation = dataclasses.replace(rig.equation, input_delay=0.008)
    slow = dataclasses.replace(rig, equation=equation)
    _, estimates, _, fine = loop(kind, slow, noisy=False, latency=latency, seconds=10.0)
    per_sample = round(PERIOD / rig.step)
    later = round((equation.delay + latency) / rig.step)
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
    equation = dataclasses.replace(LINEAR, input_delay=0.010)
    ours = kind(equation, QUIET, period=PERIOD)
    inputs = np.random.default_rng(0).uniform(-5, 5, 50)
    ours.update(0.0, np.array([0.0]), inputs[:1])
    for k, u in enumerate(inputs, start=1):
        estimate = ours.update(k * PERIOD, np.array([0.001 * k]), np.array([u]))
    known = inputs[-2:, None] + estimate.disturbance  # what was applied within the last 10 ms acts in the next 10 ms
    expected = simulate(LINEAR, estimate.state, known, step=PERIOD)[-1]
    np.testing.assert_allclose(estimate.ahead, expected, rtol=1e-9)


# What goes wrong


@pytest.fixture
def running(kind):
    """A filter after a second of a steady beam, and its time."""
    ours = kind(LINEAR, dataclasses.replace(QUIET, gate=25.0), period=PERIOD)
    rest = np.array([LINEAR.centre])
    for k in range(201):
        estimate = ours.update(k * PERIOD, np.array([0.0]), rest)
    return ours, estimate, 200 * PERIOD, rest


def unchanged(a, b):
    np.testing.assert_array_equal(a.state, b.state)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    np.testing.assert_array_equal(a.disturbance, b.disturbance)


def test_the_first_measurement_must_be_a_number(kind):
    ours = kind(LINEAR, QUIET, period=PERIOD)
    with pytest.raises(UserError, match=r"the first measurement .* is not a number"):
        ours.update(0.0, np.array([np.nan]), np.zeros(1))
    assert ours.counters.invalid == 1
    assert ours.update(PERIOD, np.array([0.02]), np.zeros(1)).state[0] == 0.02


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_measurement_that_is_no_number_is_counted_and_predicted_over(running, value):
    ours, _, t, rest = running
    estimate = ours.update(t + PERIOD, np.array([value]), rest)
    assert ours.counters.invalid == 1
    assert ours.counters.updates == 201
    assert np.isnan(estimate.normalised_innovation)
    assert estimate.time == t + PERIOD
    assert abs(estimate.state[0]) < 1e-4
    assert np.all(np.isfinite(estimate.covariance))


def test_an_input_that_is_no_number_is_the_one_before(running):
    ours, _, t, _ = running
    estimate = ours.update(t + PERIOD, np.array([0.0]), np.array([np.nan]))
    assert ours.counters.invalid == 1
    assert ours.counters.updates == 202
    assert abs(estimate.state[1]) < 1e-3


@pytest.mark.parametrize("back", [0.0, 0.005, 0.5, 1e9])
def test_a_measurement_that_is_late_or_repeated_is_ignored(running, back):
    ours, before, t, rest = running
    estimate = ours.update(t - back, np.array([0.3]), rest)
    assert ours.counters.late == 1
    assert estimate.time == t
    unchanged(estimate, before)


def test_missing_measurements_are_counted_by_the_stamps(running):
    ours, _, t, rest = running
    ours.update(t + 4 * PERIOD, np.array([0.0]), rest)
    assert ours.counters.missing == 3
    ours.update(t + 5.02 * PERIOD, np.array([0.0]), rest)  # a late wake-up is no gap
    assert ours.counters.missing == 3


def test_an_outlier_is_counted_and_not_believed(running):
    ours, _, t, rest = running
    estimate = ours.update(t + PERIOD, np.array([0.1]), rest)
    assert ours.counters.gated == 1
    assert estimate.normalised_innovation > 25.0
    assert abs(estimate.state[0]) < 1e-4
    ours.update(t + 2 * PERIOD, np.array([0.0]), rest)
    assert ours.counters.resets == 0


def test_a_run_of_outliers_wins_in_the_end(running):
    """The beam was moved by hand: after six measurements of it the filter starts afresh, its disturbance kept."""
    ours, before, t, rest = running
    for k in range(1, 7):
        assert abs(ours.update(t + k * PERIOD, np.array([0.1]), rest).state[0] - 0.1) < (0.11 if k < 6 else 1e-12)
    assert (ours.counters.gated, ours.counters.resets) == (6, 1)
    estimate = ours.update(t + 7 * PERIOD, np.array([0.1]), rest)
    assert estimate.state[0] == pytest.approx(0.1, abs=2e-3)
    assert estimate.disturbance[0] == pytest.approx(before.disturbance[0], abs=0.05)


def test_after_a_long_gap_it_starts_afresh(running):
    ours, _, t, rest = running
    estimate = ours.update(t + 30.0, np.array([0.07]), rest)
    assert ours.counters.resets == 1
    np.testing.assert_array_equal(estimate.state, [0.07, 0.0])


def test_a_stamp_in_the_far_future_without_a_number_does_not_hold_the_filter_up(running):
    """From simulated time to the clock's: nothing to predict over half a century of, and nothing to start from."""
    ours, before, _, rest = running
    estimate = ours.update(1.7e9, np.array([np.nan]), rest)
    assert ours.counters.invalid == 1
    unchanged(estimate, before)
    following = ours.update(1.7e9 + PERIOD, np.array([0.05]), rest)
    np.testing.assert_array_equal(following.state, [0.05, 0.0])
    assert following.time == 1.7e9 + PERIOD


def test_rubbish_in_any_order_leaves_a_working_filter(kind, rig):
    """NaN, outliers, gaps, repeats and steps back, at random, and then the truth."""
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    ours = kind(rig.equation, tuning, period=PERIOD, latency=0.001)
    random = np.random.default_rng(0)
    ours.update(0.0, np.zeros(1), np.ones(1))
    t = 0.0
    for _ in range(3000):
        t += random.choice([PERIOD, 2 * PERIOD, 0.3, 2.0, 0.0, -0.1], p=[0.6, 0.1, 0.1, 0.05, 0.1, 0.05])
        y = random.choice([0.0, 1e3, -1e12, np.nan, np.inf, 0.1])
        estimate = ours.update(t, np.array([y]), np.array([random.choice([0.0, 10.0, np.nan, np.inf])]))
        for value in (estimate.state, estimate.ahead, estimate.disturbance, estimate.covariance):
            assert np.all(np.isfinite(value))
    t = max(t, estimate.time)
    for k in range(1, 1500):
        estimate = ours.update(t + k * PERIOD, np.array([0.02]), np.array([rig.equation.centre]))
    assert estimate.state[0] == pytest.approx(0.02, abs=2e-3)
    assert abs(estimate.state[1]) < 0.02
    counters = ours.counters
    assert min(counters.late, counters.missing, counters.invalid, counters.gated, counters.resets) > 0


def test_a_disturbance_is_bounded(kind):
    ours = kind(LINEAR, dataclasses.replace(QUIET, disturbance_limit=0.5), period=PERIOD)
    for k in range(2000):
        estimate = ours.update(k * PERIOD, np.array([0.3 * k * PERIOD]), np.array([LINEAR.centre]))
    assert estimate.disturbance[0] == pytest.approx(0.5)


def test_an_estimate_is_not_the_filter_s_own_memory(running):
    ours, before, t, rest = running
    kept = before.state.copy()
    ours.update(t + PERIOD, np.array([0.001]), rest)
    np.testing.assert_array_equal(before.state, kept)
    before.covariance[:] = np.nan
    assert np.all(np.isfinite(ours.update(t + 2 * PERIOD, np.zeros(1), rest).covariance))


def test_reset_forgets_everything(running):
    ours, _, _, rest = running
    ours.reset()
    estimate = ours.update(0.0, np.array([0.04]), rest)
    np.testing.assert_array_equal(estimate.state, [0.04, 0.0])
    assert estimate.time == 0.0


def test_hum_that_looks_like_a_position_counts_as_noise(kind, rig):
    """60 Hz sampled at 20 Hz stands still: no filter can tell it from the beam's angle."""
    tuning = dataclasses.replace(HUM, measurement_noise=1e-4)
    ours = kind(LINEAR, tuning, period=0.05)
    for k in range(200):
        estimate = ours.update(k * 0.05, np.array([2e-3]), np.array([LINEAR.centre]))
    innovation_variance = estimate.innovation[0] ** 2 / estimate.normalised_innovation
    assert innovation_variance > HUM.hum_amplitude**2
    np.testing.assert_array_equal(estimate.covariance[3:], 0.0)


# Other models


def test_a_motor_of_three_states_shows_its_current(motor):
    """Current and load come out of the angle alone."""
    tuning = dataclasses.replace(QUIET, process_noise=(1e-4, 0.02, 0.02), disturbance_noise=0.5)
    ours = METHODS["ukf"](motor, tuning, period=PERIOD)
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
    tuning = dataclasses.replace(QUIET, process_noise=(1e-4, 1e-4, 0.5, 0.1), disturbance_noise=0.01)
    ours = METHODS["mhe"](flexible_joint, tuning, period=PERIOD)
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class TwoInputs(Linear):
    inputs: ClassVar[Any] = (Variable(name="left", unit="V"), Variable(name="right", unit="V"))


def test_what_the_filter_is_not_for_is_refused(kind):
    with pytest.raises(UserError, match="TwoInputs: the filter takes one input and one output"):
        kind(TwoInputs(), QUIET, period=PERIOD)
    with pytest.raises(UserError, match="process_noise has 3 entries; the model has 2 states"):
        kind(LINEAR, dataclasses.replace(QUIET, process_noise=(1.0, 1.0, 1.0)), period=PERIOD)
