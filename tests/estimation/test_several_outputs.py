"""Systems of several inputs and outputs: the textbook filter, batch least squares, and sensors that disagree."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from hybrid_sysid_ros.core import System, bounded, simulate
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.estimation import SensorChannel, Tuning, estimator_class
from hybrid_sysid_ros.estimation.consistency import normalised_errors
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import targets

PERIOD = 0.005
A = np.array([[-1.0, 3.0, -6.0], [-4.0, -2.0, 5.0], [2.0, -3.0, -1.5]])
B = np.array([[2.0, 0.0], [0.0, 3.0], [1.0, -1.0]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, 2.0]])
D = np.array([[0.0, 0.0], [0.3, 0.0]])


@dataclass(frozen=True, kw_only=True)
class Plate(System):
    """x' = A x + B u, of which the first state and a mixture of the others with the first input are measured."""

    states = ("tilt [rad]", "turn [rad/s]", "load [N]")
    inputs = ("left [V]", "right [V]")
    outputs = ("tilt", "force [N]")
    delays = {"left": "left_delay", "right": "right_delay"}

    left_delay: float = bounded(0.0, 0.0, 0.1, unit="s")
    """Delay of the left input."""
    right_delay: float = bounded(0.0, 0.0, 0.1, unit="s")
    """Delay of the right input."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return [sum(a * b for a, b in zip(row, (*x, *u), strict=True)) for row in np.hstack([A, B])]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[0], 0.5 * x[1] + 2.0 * x[2] + 0.3 * u[0]


TUNING = Tuning(
    measurement_noise=(0.01, 0.05),
    process_noise=(0.05, 0.2, 0.1),
    disturbance_noise=(0.1, 0.2),
    disturbance_limit=(1e3,),
    initial_deviation=(0.3, 0.5, 0.4),
    gate=1e9,
)


class Textbook:
    """Kalman (1960) on z = [x, d], matrices and vectors as they are written."""

    def __init__(self, tuning: Tuning, first: np.ndarray, covariance: np.ndarray) -> None:
        self.f = np.block([[np.eye(3) + PERIOD * A, PERIOD * B], [np.zeros((2, 3)), np.eye(2)]])
        self.h = np.hstack([C, D])
        self.q = PERIOD * np.diag([*tuning.process_noise, *tuning.disturbance_noise]) ** 2
        self.r = np.diag(tuning.measurement_noise) ** 2
        self.z, self.p = first, covariance

    def predict(self, u: np.ndarray) -> None:
        self.z = self.f @ self.z + np.concatenate([PERIOD * B @ u, np.zeros(2)])
        self.p = self.f @ self.p @ self.f.T + self.q

    def correct(self, y: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float]:
        there = np.isfinite(y)
        h, r = self.h[there], self.r[np.ix_(there, there)]
        innovation = y[there] - h @ self.z - (D @ u)[there]
        s = h @ self.p @ h.T + r
        gain = self.p @ h.T @ np.linalg.inv(s)
        self.z = self.z + gain @ innovation
        self.p = self.p - gain @ s @ gain.T
        return innovation, float(innovation @ np.linalg.solve(s, innovation))


def beginning(estimate) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([estimate.state, estimate.disturbance]), estimate.covariance.copy()


def test_two_outputs_one_of_them_a_map_are_those_of_the_textbook(kind):
    """NaN in one or both of them now and then; innovations are those of the vector's update."""
    random = np.random.default_rng(0)
    ours = kind(Plate(), TUNING, period=PERIOD)
    textbook = Textbook(TUNING, *beginning(ours.update(0.0, np.array([0.1, -0.2]), np.zeros(2))))
    for k in range(1, 400):
        u, y = random.uniform(-3, 3, 2), random.normal(size=2)
        y[0 if k % 5 == 2 else 1] = np.nan if k % 5 in (2, 4) else y[1]
        if k % 11 == 7:
            y[:] = np.nan
        textbook.predict(u)
        innovation, squared = textbook.correct(y, u)
        estimate = ours.update(k * PERIOD, y, u)
        np.testing.assert_allclose(
            np.concatenate([estimate.state, estimate.disturbance]), textbook.z, rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(estimate.covariance, textbook.p, rtol=0, atol=1e-9)
        np.testing.assert_allclose(estimate.innovation[np.isfinite(y)], innovation, rtol=0, atol=1e-9)
        assert np.all(np.isnan(estimate.innovation[~np.isfinite(y)]))
        if np.any(np.isfinite(y)):
            assert estimate.normalised_innovation == pytest.approx(squared, rel=1e-6, abs=1e-9)
    assert ours.counters.invalid + ours.counters.updates == 2 * 400


def test_each_input_acts_after_its_own_delay(kind):
    """Delays of one and three samples; `ahead` is after the longest, in which the newest left input still acts."""
    system = Plate(left_delay=PERIOD, right_delay=3 * PERIOD)
    ours, random = kind(system, TUNING, period=PERIOD), np.random.default_rng(1)
    inputs = random.uniform(-3, 3, (200, 2))
    inputs[0] = 0.0  # and before

    def acting(k: int) -> np.ndarray:
        return np.array([inputs[max(k - 1, 0), 0], inputs[max(k - 3, 0), 1]])

    textbook = Textbook(TUNING, *beginning(ours.update(0.0, np.array([0.1, -0.2]), inputs[0])))
    for k in range(1, 197):
        y = random.normal(size=2)
        textbook.predict(acting(k))
        textbook.correct(y, acting(k))
        estimate = ours.update(k * PERIOD, y, inputs[k])
        np.testing.assert_allclose(
            np.concatenate([estimate.state, estimate.disturbance]), textbook.z, rtol=0, atol=1e-9
        )
        held = np.array([[inputs[k, 0], inputs[k - 2 + i, 1]] for i in range(3)]) if k > 1 else None
        if held is not None:
            plain = Plate()
            expected = simulate(plain, estimate.state, held + estimate.disturbance, step=PERIOD)[-1]
            np.testing.assert_allclose(estimate.ahead, expected, rtol=0, atol=1e-9)


def drawn(seed: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outputs, inputs and true [x, d] of a plate as the tuning says."""
    random, book = np.random.default_rng(seed), Textbook(TUNING, np.zeros(5), np.eye(5))
    z = random.normal(size=5) * [0.0, 0.5, 0.4, 1.0, 2.0]
    u, rows = np.zeros(2), []
    for _ in range(samples):
        y = book.h @ z + D @ u + random.normal(size=2) * TUNING.measurement_noise
        rows.append((y, u, z))
        u = random.uniform(-3, 3, 2)
        z = (
            book.f @ z
            + np.concatenate([PERIOD * B @ u, np.zeros(2)])
            + np.sqrt(np.diag(book.q)) * random.normal(size=5)
        )
    measured, inputs, truth = (np.array(column) for column in zip(*rows, strict=True))
    return measured, inputs, truth


@pytest.mark.parametrize("method", targets("estimators"))
def test_squared_errors_and_innovations_are_in_their_bands(method):
    """Mean over 40 seeds of e' P^-1 e of five states, the hidden ones and the offsets among them."""
    errors, covariances, squares = [], [], []
    for seed in range(40):
        measured, inputs, truth = drawn(seed, 120)
        ours = estimator_class(method)(Plate(), TUNING, period=PERIOD)
        estimates = [ours.update(k * PERIOD, measured[k], inputs[k]) for k in range(120)]
        errors.append([beginning(estimates[k])[0] - truth[k] for k in (30, 60, 119)])
        covariances.append([estimates[k].covariance for k in (30, 60, 119)])
        squares += [estimate.normalised_innovation for estimate in estimates[1:]]
    mean = normalised_errors(np.array(errors), np.array(covariances)).mean(axis=0)
    low, high = chi2.ppf([0.005, 0.995], 5 * 40) / 40
    assert np.all((low < mean) & (mean < high))
    low, high = chi2.ppf([0.005, 0.995], 2 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_a_horizon_that_holds_all_is_batch_least_squares():
    """All measurements and all transitions as rows of one linear problem, solved by numpy."""
    samples = 25
    measured, inputs, _ = drawn(3, samples)
    ours = estimator_class("mhe")(Plate(), dataclasses.replace(TUNING, horizon=100), period=PERIOD)
    z0, p0 = beginning(ours.update(0.0, measured[0], inputs[0]))
    book = Textbook(TUNING, z0, p0)
    rows, values = [np.zeros((5, 5 * samples))], [np.linalg.solve(np.linalg.cholesky(p0), z0)]
    rows[0][:, :5] = np.linalg.inv(np.linalg.cholesky(p0))
    for k in range(1, samples):
        estimate = ours.update(k * PERIOD, measured[k], inputs[k])
        row = np.zeros((5, 5 * samples))
        row[:, 5 * k - 5 : 5 * k], row[:, 5 * k : 5 * k + 5] = -book.f, np.eye(5)
        weights = 1.0 / np.sqrt(np.diag(book.q))
        rows.append(weights[:, None] * row)
        values.append(weights * np.concatenate([PERIOD * B @ inputs[k], np.zeros(2)]))
        row = np.zeros((2, 5 * samples))
        row[:, 5 * k : 5 * k + 5] = book.h
        weights = 1.0 / np.array(TUNING.measurement_noise)
        rows.append(weights[:, None] * row)
        values.append(weights * (measured[k] - D @ inputs[k]))
    matrix = np.vstack(rows)
    best = np.linalg.lstsq(matrix, np.concatenate(values), rcond=None)[0][-5:]
    np.testing.assert_allclose(np.concatenate([estimate.state, estimate.disturbance]), best, rtol=0, atol=1e-8)
    np.testing.assert_allclose(estimate.covariance, np.linalg.inv(matrix.T @ matrix)[-5:, -5:], rtol=0, atol=1e-8)


PLAIN = dataclasses.replace(TUNING, gate=25.0, channels={"gyro": SensorChannel(of="turn", noise=1e-3)}, window=0.1)


def test_a_channel_alone_begins_and_the_outputs_join(kind):
    """Only the gyro tells something at first; what the others say then is believed at its first word."""
    ours = kind(Plate(), PLAIN, period=PERIOD)
    estimate = ours.correct(0.0, 0.2, "gyro")
    assert estimate.state[1] == pytest.approx(0.2)
    for k in range(1, 10):
        ours.correct(k * PERIOD, 0.2, "gyro")
    estimate = ours.update(10 * PERIOD, np.array([5.0, np.nan]), np.zeros(2))
    assert estimate.state[0] == pytest.approx(5.0, abs=0.05)
    assert estimate.time == 10 * PERIOD
    assert np.all(np.isfinite(estimate.covariance))


def test_a_precise_sensor_that_a_coarse_one_does_not_contradict_wins(kind):
    """The belief is wrong by thirty times the precise noise, but by less than the coarse one can tell."""
    coarse = dataclasses.replace(
        PLAIN,
        measurement_noise=(1.0, 10.0),
        process_noise=(1e-3,),
        disturbance_noise=(0.0,),
        initial_deviation=(1e-3, 1e-3, 1e-3),
        channels={"laser": SensorChannel(of="tilt", noise=1e-3)},
    )
    ours = kind(Plate(), coarse, period=PERIOD)
    for k in range(60):
        ours.update(k * PERIOD, np.zeros(2), np.zeros(2))
        if k < 10:
            ours.correct(k * PERIOD, 0.0, "laser")
        if k > 40:
            estimate = ours.correct(k * PERIOD, 0.03, "laser")
    assert ours.counters.resets > 0
    assert estimate.state[0] == pytest.approx(0.03, abs=5e-3)


def test_outputs_that_jump_together_win_together_and_one_alone_is_an_outlier(kind):
    ours = kind(Plate(), dataclasses.replace(PLAIN, channels={}), period=PERIOD)
    for k in range(100):
        before = ours.update(k * PERIOD, np.zeros(2), np.zeros(2))
    for k in range(100, 106):
        estimate = ours.update(k * PERIOD, np.array([1.0, 4.0]), np.zeros(2))
    assert (ours.counters.gated, ours.counters.resets) == (12, 1)
    assert abs(before.state[0]) < 1e-6
    assert estimate.state[0] == pytest.approx(1.0, abs=0.05)


# What can't be estimated


@dataclass(frozen=True, kw_only=True)
class HeatedCart(System):
    """Nothing pulls the cart back, so its speed does not tell where it is; the heat of its motor dies away."""

    states = ("place [m]", "speed [m/s]", "heat [K]")
    inputs = ("push [m/s^2]", "pull [m/s^2]")
    outputs = ("speed",)

    drag: float = bounded(1.0, 0.0, 10.0, unit="1/s")
    """Of the wheels."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0] - u[1] - self.drag * x[1], -5.0 * x[2] + u[0] * u[0]


CART = Tuning(
    measurement_noise=(0.01,),
    process_noise=(0.01, 0.1, 0.1),
    disturbance_noise=(0.1, 0.0),
    disturbance_limit=(1.0,),
    channels={"tape": SensorChannel(of="place", noise=0.01)},
)


def test_a_state_that_nothing_shows_is_refused_by_its_name(kind):
    with pytest.raises(UserError, match="HeatedCart: state place can't be told from speed"):
        kind(HeatedCart(), dataclasses.replace(CART, channels={}), period=PERIOD)
    kind(HeatedCart(), CART, period=PERIOD)  # the tape shows it; the heat dies away unseen


def test_offsets_of_inputs_that_act_alike_are_refused(kind):
    with pytest.raises(UserError, match=r"an offset of input (push|pull) can't be told"):
        kind(HeatedCart(), dataclasses.replace(CART, disturbance_noise=(0.1, 0.1)), period=PERIOD)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"process_noise": (1.0, 1.0)}, "process_noise has 2 entries for 3 states: place, speed, heat"),
        ({"disturbance_noise": (0.1, -1.0)}, "disturbance_noise of input pull is -1"),
        ({"measurement_noise": (np.nan,)}, "measurement_noise of output speed is nan"),
        ({"initial_deviation": (1.0, np.inf, 1.0)}, "initial_deviation of state speed is inf"),
    ],
)
def test_a_tuning_that_does_not_fit_is_reported(changes, reason):
    with pytest.raises(UserError, match=reason):
        dataclasses.replace(CART, **changes).checked(HeatedCart())


def test_another_number_of_outputs_is_reported(kind):
    with pytest.raises(UserError, match="1 outputs and 2 inputs were given"):
        kind(Plate(), TUNING, period=PERIOD).update(0.0, np.zeros(1), np.zeros(2))
