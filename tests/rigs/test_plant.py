"""The simulated plant: what acts on it, and what its sensors show, against numbers worked out without it."""

import numpy as np
import pytest
from scipy import signal

from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.sensor import Hum, LowPass, LowPassFilter, Quantiser, Sensor
from tests.rigs.toys import Lags, rig_of

STEP = 0.001


def readings(plant, inputs):
    """Readings (steps + 1, outputs) under inputs (steps, inputs)."""
    rows = [plant.measure().outputs]
    for u in inputs:
        plant.advance(u)
        rows.append(plant.measure().outputs)
    return np.array(rows)


def test_each_input_acts_after_its_own_delay_and_each_output_is_that_of_the_map():
    """A step of both: lags that begin 12.5 and 50 ms later; within the step of 12.5 ms half of it acts."""
    plant = Plant(rig_of(Lags()), seed=0)
    y = readings(plant, np.tile([2.0, 3.0], (200, 1)))
    t = STEP * np.arange(201)
    second = 3.0 * (1 - np.exp(-np.maximum(t - 0.05, 0) / 0.5))
    np.testing.assert_allclose(y[:, 1], second, atol=1e-9)
    first = 2.0 * (1 - np.exp(-np.maximum(t - 0.0125, 0) / 0.5))
    np.testing.assert_allclose(y[14:, 0], first[14:], atol=2e-6)  # mean over the step it begins in
    acted = np.where(np.arange(201) > 50, 3.0, 0.0)  # over the step that ended
    np.testing.assert_allclose(y[:, 2], y[:, 0] * y[:, 1] + acted, atol=1e-12)


def test_white_noise_and_hum_are_as_strong_as_told_and_in_the_unit_of_readings():
    sensors = {
        "first": Sensor(unit="mm", scale=1e-3, white_noise=2.0),
        "second": Sensor(unit="K", hum=Hum(rms=0.5, hertz=50.0)),
    }
    y = readings(Plant(rig_of(Lags(), sensors=sensors), seed=1), np.zeros((20_000, 2)))
    assert np.std(y[:, 0]) == pytest.approx(2e-3, rel=0.02)  # 20000 samples: 0.5 %
    assert abs(np.mean(y[:, 0])) < 5 * 2e-3 / np.sqrt(20_000)
    correlation = np.mean(y[1:, 0] * y[:-1, 0]) / np.mean(y[:, 0] ** 2)
    assert abs(correlation) < 0.03
    hum = y[:20_000, 1]
    assert np.std(hum) == pytest.approx(0.5, rel=1e-6)
    spectrum = np.abs(np.fft.rfft(hum))
    assert np.argmax(spectrum) == 50 * 20
    assert np.all(y[:, 2] == 0.0)


def test_a_quantiser_shows_counts_and_ends_at_its_range():
    quantiser = Quantiser(range=1.0, bits=4)
    assert quantiser.count == 0.125
    coarse = Sensor(unit="m", quantiser=quantiser)
    y = readings(Plant(rig_of(Lags(), sensors={"first": coarse}), seed=0), np.tile([2.0, 0.0], (2000, 1)))[:, 0]
    np.testing.assert_array_equal(y / 0.125, np.round(y / 0.125))
    assert y.max() == 1.0
    assert set(np.unique(y)) == {0.125 * k for k in range(9)}
    encoder = Quantiser(count=0.3)
    assert encoder.read(1e6) == pytest.approx(1e6, abs=0.15)
    assert encoder.read(-0.16) == pytest.approx(-0.3)


def test_a_sensor_may_show_what_was():
    """A delay of 20.5 ms: what the same sensor without it showed then."""
    rig, late = rig_of(Lags()), rig_of(Lags(), sensors={"first": Sensor(unit="m", delay=0.0205)})
    inputs = np.column_stack([np.sin(0.05 * np.arange(500)), np.zeros(500)])
    now, then = (readings(Plant(each, seed=0), inputs)[:, 0] for each in (rig, late))
    np.testing.assert_allclose(then[21:], 0.5 * (now[1:-20] + now[:-21]), atol=1e-12)
    assert np.all(then[:21] == now[0])


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_the_low_pass_is_scipy_s_butterworth_by_euler(order):
    """Its poles are those of scipy's analogue filter, moved by forward Euler; it has unit gain at rest."""
    part = LowPass(hertz=15.0, order=order)
    ours = LowPassFilter(part, STEP)
    _, poles, _ = signal.butter(order, 2 * np.pi * 15.0, analog=True, output="zpk")
    expected, found = 1 + STEP * poles, np.linalg.eigvals(ours.transition)
    for pole in expected:
        assert np.min(np.abs(found - pole)) < 1e-9
    gain = ours.reading @ np.linalg.solve(np.eye(order) - ours.transition, ours.gain)
    assert gain == pytest.approx(1.0, rel=1e-9)
    rng = np.random.default_rng(0)
    inputs = rng.normal(size=400)
    system = signal.dlti(ours.transition, ours.gain[:, None], ours.reading[None], np.zeros((1, 1)), dt=STEP)
    _, output, _ = signal.dlsim(system, inputs)
    values = []
    for value in inputs:
        values.append(ours.value)
        ours.advance(value)
    np.testing.assert_allclose(values, output[:, 0], atol=1e-9)


def test_filtered_readings_follow_the_readings():
    rig = rig_of(Lags(), sensors={"first": Sensor(unit="m", white_noise=0.1, low_pass=LowPass(hertz=5.0, order=2))})
    plant, check = Plant(rig, seed=0), LowPassFilter(LowPass(hertz=5.0, order=2), STEP)
    check.reset(0.0)
    for _ in range(300):
        shown = plant.measure()
        assert shown.filtered[0] == pytest.approx(check.value, abs=1e-12)
        assert shown.filtered[1] == shown.outputs[1]  # no low-pass
        check.advance(shown.outputs[0])
        plant.advance([1.0, 1.0])


def test_inputs_are_bounded_on_each_side_and_never_nan():
    actuators = (Actuator(low=1.0, high=4.0), Actuator(low=-2.0, high=5.0, quantiser=Quantiser(count=0.5)))
    for value, expected in (
        (np.nan, (1.0, 0.0)), (np.inf, (4.0, 5.0)), (-np.inf, (1.0, -2.0)), (2.3, (2.3, 2.5)),
    ):  # fmt: skip
        assert tuple(actuator.bounded(value) for actuator in actuators) == expected
    plant = Plant(rig_of(Lags(), actuators=actuators), seed=0, noisy=False)
    y = readings(plant, np.tile([np.nan, np.inf], (10_000, 1)))
    np.testing.assert_allclose(y[-1], [1.0, 5.0, 10.0], atol=1e-6)


def test_a_bias_acts_beyond_what_is_commanded():
    plant = Plant(rig_of(Lags()), seed=0, bias=[0.5, -1.0])
    np.testing.assert_allclose(readings(plant, np.zeros((10_000, 2)))[-1, :2], [0.5, -1.0], atol=1e-6)


def test_parameters_may_change_on_the_way():
    """A lag that becomes ten times as long: the rate falls to a tenth at once."""
    plant = Plant(rig_of(Lags(push_delay=0.0)), seed=0)
    y = readings(plant, np.tile([1.0, 0.0], (100, 1)))[:, 0]
    plant.change(lag=5.0)
    later = readings(plant, np.tile([1.0, 0.0], (2, 1)))[:, 0]
    before = (y[-1] - y[-2]) / (1 - y[-2])
    assert (later[1] - later[0]) / (1 - later[0]) == pytest.approx(before / 10, rel=1e-3)


def test_a_seed_decides_all_noise():
    sensors = {
        name: Sensor(unit="", scale=2.0, white_noise=1.0, hum=Hum(rms=1.0, hertz=3.0)) for name in ("first", "second")
    }
    rig = rig_of(Lags(), sensors=sensors)
    one, same, other = (readings(Plant(rig, seed=seed), np.zeros((1500, 2))) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert np.all(np.std(one - other, axis=0)[:2] > 1.0)
    assert abs(np.corrcoef(one[:, 0], one[:, 1])[0, 1]) < 0.9  # sensors have noise of their own


def test_a_plant_begins_where_it_is_put_with_settled_inputs():
    plant = Plant(rig_of(Lags()), seed=0)
    plant.reset([2.0, 3.0], inputs=[2.0, 3.0])
    np.testing.assert_allclose(readings(plant, np.tile([2.0, 3.0], (100, 1)))[-1], [2.0, 3.0, 9.0], atol=1e-12)
    assert plant.time == pytest.approx(0.1)


def test_the_simulated_rig_stops_at_the_end_of_its_travel():
    plant = Plant(rigs.load("cam_beam"), seed=0)
    low, high = plant.rig.travel[:, 0]
    for inputs, end in ((10.0, high), (-10.0, low)):
        for _ in range(3000):
            plant.advance(inputs)
            assert low <= plant.state[0] <= high
        assert plant.state[0] == end
        assert plant.state[1] == 0.0
    assert plant.stopped > 2000
    plant.reset([0.0, 0.3])
    before = plant.stopped
    for _ in range(10):
        plant.advance(0.0)
    assert plant.stopped == before


def test_a_brake_slows_down_and_holds_until_it_is_overcome(slider):
    """A block of friction 2 under a push u and a brake b [m/s^2]: v' = u - 2 - b, and it stands while u < 2 + b."""
    plant = Plant(rig_of(slider, limit=20.0), seed=0)
    for _ in range(500):
        plant.advance([6.0])
    assert plant.state[1] == pytest.approx(0.5 * 4.0, rel=1e-6)
    plant.brake[1] = 7.0
    for _ in range(400):
        plant.advance([6.0])
    assert plant.state[1] == pytest.approx(2.0 - 0.4 * 3.0, rel=1e-6)
    for _ in range(400):
        plant.advance([6.0])
    stood = plant.state.copy()
    assert stood[1] == 0.0
    for _ in range(1000):
        plant.advance([8.9])
    np.testing.assert_array_equal(plant.state, stood)
    for _ in range(1000):
        plant.advance([10.0])
    assert plant.state[1] == pytest.approx(1.0, rel=1e-6)
    assert plant.measure().outputs[0] == plant.state[0]
