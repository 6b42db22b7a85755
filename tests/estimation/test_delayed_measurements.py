"""Measurements out of order and of further sensors: what comes of them is what the right order would have given."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.estimation import SensorChannel, Tuning
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import Linear
from tests.one_joint import narx as narx_of
from tests.straight_beam import straight

PERIOD = 0.005
LINEAR = straight(Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.004))
TUNING = Tuning(
    measurement_noise=(5e-4,),
    process_noise=(1e-4, 0.2),
    disturbance_noise=(0.05,),
    disturbance_limit=(1e3,),
    hum_hertz=(60.0,),
    hum_amplitude=(1e-3,),
    hum_noise=(1e-4,),
    gate=1e9,
    patience=5,
    channels={"camera": SensorChannel(of="position", noise=2e-3), "gyro": SensorChannel(of="velocity", noise=1e-2)},
    horizon=60,
)


def driven(samples):
    """Measurements, inputs and true states of a linear beam; input k acts between k - 1 and k, a delay later."""
    random = np.random.default_rng(3)
    inputs = np.repeat(random.uniform(-4.0, 6.0, samples // 20 + 1), 20)[:samples]
    fine = np.repeat(inputs[1:], 5)[:, None]
    delayed = np.concatenate([np.full((4, 1), inputs[0]), fine])[: len(fine)]
    system = dataclasses.replace(LINEAR, input_delay=0.0)
    states = simulate(system, np.zeros(2), delayed, step=0.001)[::5]
    return states[:, 0] + 5e-4 * random.normal(size=samples), inputs, states


def close(one, other, relative):
    scales = np.sqrt(np.diag(other.covariance))[:2]
    assert np.all(np.abs(one.state - other.state) <= relative * scales)
    np.testing.assert_allclose(one.ahead, other.ahead, rtol=1e-2, atol=1e-5)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-3, atol=1e-5 * np.max(other.covariance))


def test_the_order_of_arrival_does_not_matter(kind):
    """A camera at 30 Hz, 80 ms late, against the same frames on time; on a linear model all methods are exact."""
    measured, inputs, states = driven(300)
    late, punctual = (kind(LINEAR, TUNING, period=PERIOD, latency=0.001) for _ in range(2))
    frames = [(k, states[k, 0] + 1e-3 * np.sin(7 * k)) for k in range(1, 270, 7)]
    for k in range(300):
        a = late.update(k * PERIOD, measured[k : k + 1], inputs[k : k + 1])
        b = punctual.update(k * PERIOD, measured[k : k + 1], inputs[k : k + 1])
        for at, value in frames:
            if at == k:
                b = punctual.correct(k * PERIOD, value, "camera")
            if at == k - 16:
                a = late.correct(at * PERIOD, value, "camera")
    close(a, b, 1e-6)
    assert a.time == b.time == 299 * PERIOD
    assert late.counters.delayed == len(frames)
    assert late.counters.updates == punctual.counters.updates == 300 + len(frames)


def test_a_measurement_that_was_overtaken_is_put_in_its_place(kind):
    measured, inputs, _ = driven(200)
    ours, ordered = (kind(LINEAR, TUNING, period=PERIOD) for _ in range(2))
    for k in range(200):
        ordered_estimate = ordered.update(k * PERIOD, measured[k : k + 1], inputs[k : k + 1])
        if k % 10 == 4:
            continue  # overtaken by three; the next one tells the mean input of both intervals, of which all are alike
        estimate = ours.update(k * PERIOD, measured[k : k + 1], inputs[k : k + 1])
        if k % 10 == 7:
            estimate = ours.update((k - 3) * PERIOD, measured[k - 3 : k - 2], np.array([np.nan]))
    close(estimate, ordered_estimate, 1e-6)
    assert ours.counters.delayed == 20
    assert ours.counters.missing == 20


def test_a_frame_between_two_measurements_counts_at_its_own_time(kind):
    """The velocity of a beam that moves evenly, from frames between the measurements, before and after them."""
    ours = kind(LINEAR, TUNING, period=PERIOD)
    balance = LINEAR.centre + (0.5 * LINEAR.damping) / LINEAR.gain
    for k in range(400):
        t = k * PERIOD
        u = balance + LINEAR.stiffness * 0.5 * (t - 0.004) / LINEAR.gain
        estimate = ours.update(t, np.array([0.5 * t]), np.array([u]))
        for seen in (t - 0.0123, t + 0.002) if k > 10 else ():
            estimate = ours.correct(seen, 0.5 * seen, "camera")
    assert estimate.time == pytest.approx(399 * PERIOD + 0.002)
    assert estimate.state[0] == pytest.approx(0.5 * estimate.time, abs=1e-4)
    assert estimate.state[1] == pytest.approx(0.5, abs=5e-3)
    assert ours.counters.late == 0


def test_a_channel_of_the_velocity_makes_the_velocity_known(kind):
    ours = kind(LINEAR, TUNING, period=PERIOD)
    for k in range(50):
        before = ours.update(k * PERIOD, np.zeros(1), np.array([LINEAR.centre]))
    after = ours.correct(49 * PERIOD, 0.0, "gyro")
    # In information: 1 / variances add up.
    assert 1 / after.covariance[1, 1] == pytest.approx(1 / before.covariance[1, 1] + 1e4, rel=1e-3)


def test_what_is_older_than_the_window_or_far_ahead_is_ignored(kind):
    tuning = dataclasses.replace(TUNING, window=0.1, horizon=20)
    ours = kind(LINEAR, tuning, period=PERIOD)
    for k in range(100):
        before = ours.update(k * PERIOD, np.zeros(1), np.ones(1))
    for time in (before.time - 0.12, 0.0, -5.0, before.time + 0.12, 1.7e9, np.nan):
        after = ours.correct(time, 0.01, "camera")
        np.testing.assert_array_equal(after.state, before.state)
        np.testing.assert_array_equal(after.covariance, before.covariance)
    assert ours.counters.late == 6
    ours.correct(before.time - 0.02, 0.01, "camera")
    assert (ours.counters.late, ours.counters.delayed) == (6, 1)


def test_a_frame_that_is_no_number_or_comes_twice_is_not_used(kind):
    ours = kind(LINEAR, TUNING, period=PERIOD)
    for k in range(20):
        ours.update(k * PERIOD, np.zeros(1), np.ones(1))
    ours.correct(0.05, np.nan, "camera")
    assert ours.counters.invalid == 1
    first = ours.correct(0.05, 1e-3, "camera")
    again = ours.correct(0.05, 1e-3, "camera")
    np.testing.assert_array_equal(first.state, again.state)
    assert ours.counters.late == 1


def test_a_channel_that_contradicts_a_sensor_that_is_believed_is_gated_and_resets_nothing(kind):
    ours = kind(LINEAR, dataclasses.replace(TUNING, gate=25.0), period=PERIOD)
    for k in range(100):
        before = ours.update(k * PERIOD, np.zeros(1), np.array([LINEAR.centre]))
        if k > 50:
            ours.correct(k * PERIOD - 0.02, 1.0, "camera")
    assert abs(before.state[0]) < 1e-4
    assert (ours.counters.gated, ours.counters.resets) == (49, 0)


def test_a_channel_that_is_not_there_is_reported(kind):
    ours = kind(LINEAR, TUNING, period=PERIOD)
    with pytest.raises(UserError, match="no channel lidar: known are camera, gyro"):
        ours.correct(0.0, 0.0, "lidar")


# A recurrence steps by its own samples, y+ = .9 y + .1 (u + d), and has no parameters with names.

ARX = narx_of(
    exponents=((1, 0), (0, 1)),
    coefficients=(0.9, 0.1),
    output_lags=1,
    input_lags=1,
    output_range=(-100.0, 100.0),
    input_range=(-100.0, 100.0),
)
PLAIN = dataclasses.replace(
    TUNING,
    process_noise=(0.3,),
    measurement_noise=(0.1,),
    hum_hertz=(0.0,),
    hum_amplitude=(0.0,),
    hum_noise=(0.0,),
    channels={},
)


def test_a_recurrence_has_the_textbook_s_filter(kind):
    period = ARX.sampling_time
    assert period is not None
    random = np.random.default_rng(0)
    ours = kind(ARX, PLAIN, period=period, latency=0.001)
    estimate = ours.update(0.0, np.array([0.2]), np.zeros(1))
    z, p = np.array([0.2, 0.0]), estimate.covariance[:2, :2]
    f, q = np.array([[0.9, 0.1], [0.0, 1.0]]), period * np.diag([0.3**2, 0.05**2])
    for k in range(1, 100):
        u, y = random.normal(), random.normal()
        estimate = ours.update(k * period, np.array([y]), np.array([u]))
        z, p = f @ z + np.array([0.1 * u, 0.0]), f @ p @ f.T + q
        gain = p[:, 0] / (p[0, 0] + 0.1**2)
        z, p = z + gain * (y - z[0]), p - np.outer(gain, p[0])
        np.testing.assert_allclose([*estimate.state, *estimate.disturbance], z, rtol=1e-6)
        np.testing.assert_allclose(estimate.covariance[:2, :2], p, rtol=1e-6)
        np.testing.assert_array_equal(estimate.ahead, estimate.state)  # a millisecond is no sample


def test_a_recurrence_knows_only_its_own_samples(kind):
    with pytest.raises(UserError, match=r"Narx steps by 0\.05 s: measurements must come whole steps apart"):
        kind(ARX, PLAIN, period=PERIOD)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"channels": {"camera": SensorChannel(of="yaw", noise=1.0)}},
            "channel camera measures yaw, which is none of position, velocity",
        ),
        (
            {"channels": {"camera": SensorChannel(of="position", noise=0.0)}},
            "channel camera: noise is 0: it must be above 0",
        ),
        ({"measurement_noise": (0.0,)}, "measurement_noise of output position is 0"),
        ({"input_noise": (-1.0,)}, "input_noise of input drive is -1"),
        ({"horizon": 0}, "horizon is 0"),
        ({"window": np.inf}, "window inf s"),
    ],
)
def test_numbers_that_make_no_estimator_are_reported(kind, changes, reason):
    with pytest.raises(UserError, match=reason):
        kind(LINEAR, dataclasses.replace(TUNING, **changes), period=PERIOD)
