"""The beam's sensor and filter: their noise, their steps and their ends, as the author's records show them."""

import numpy as np
import pytest
from scipy.io import loadmat

from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.sensor import LowPassFilter

COUNT = 10.0 / 2048  # V, of the 12-bit converter over +-10 V


@pytest.fixture(scope="module")
def resting(rig):
    """Three seconds of the sensor while the beam is stuck [V], and the counts it shows."""
    plant = Plant(rig, seed=3)
    volts = np.empty(3000)
    for k in range(len(volts)):
        plant.advance(rig.system.centre)
        volts[k] = plant.measure().outputs[0] / rig.display[0].scale
    return volts


def test_a_resting_sensor_is_as_noisy_as_the_rig(resting):
    assert 0.05 <= np.std(resting) <= 0.06


def test_its_noise_is_mains_hum_above_all(resting):
    spectrum = np.abs(np.fft.rfft(resting - resting.mean())) ** 2
    assert np.argmax(spectrum) == 60 * 3  # bins of 1/3 Hz
    assert 0.7 < spectrum[180] / spectrum.sum() < 0.95


def test_the_sensor_counts_in_steps_of_5_millivolts(resting):
    np.testing.assert_allclose(resting / COUNT, np.round(resting / COUNT), atol=1e-9)
    assert len(np.unique(resting)) > 20


def test_the_records_are_as_noisy_and_count_in_the_same_steps(data, experiments, rig):
    noise, hum = [], []
    for name, experiment in experiments.items():
        content = loadmat(data / "bab" / f"{name}.mat")
        first = int(np.flatnonzero(content["trigger"].ravel())[0])
        rest = content["y"].ravel()[first - 2000 : first]
        spectrum = np.abs(np.fft.rfft(rest - rest.mean())) ** 2
        noise.append(np.std(rest))
        hum.append(np.sqrt(2 * spectrum[119:122].sum()) / len(rest))
        assert np.min(np.diff(np.unique(experiment.output))) == pytest.approx(COUNT, rel=0.02)
    assert rig.sensors[0].noise == pytest.approx(np.mean(noise), rel=0.1)
    assert rig.sensors[0].hum.rms == pytest.approx(np.mean(hum), rel=0.15)


def test_the_sensor_ends_at_ten_volts(rig):
    assert rig.sensors[0].quantiser.read(12.3) == 10.0
    assert rig.sensors[0].quantiser.read(-1e9) == -10.0
    assert rig.sensors[0].quantiser.read(0.004) == pytest.approx(COUNT)
    assert rig.sensors[0].quantiser.read(0.002) == 0.0


def test_one_volt_is_1_3_degrees_of_the_beam(rig):
    assert rig.display[0].si(np.array([1.0])) == pytest.approx(np.deg2rad(1.3))
    assert rig.display[0].shown(np.array([np.deg2rad(6.5)])) == pytest.approx(5.0)


def test_the_filter_is_a_butterworth_low_pass_of_20_hertz(rig):
    """Gain 1 / sqrt(2) at 20 Hz, 1 / 2^6 at 40 Hz (sixth order), delay about 31 ms: 3.8637 / (2 pi 20 Hz)."""

    def response(hertz, step=2e-5):
        filtered = LowPassFilter(rig.sensors[0].low_pass, step)
        t = np.arange(0, 0.4 + 2 / hertz, step)
        values = np.empty(len(t))
        for k, y in enumerate(np.sin(2 * np.pi * hertz * t)):
            values[k] = filtered.value
            filtered.advance(y)
        last = t >= t[-1] - 1 / hertz
        return 2 * np.mean(values[last] * np.exp(-2j * np.pi * hertz * t[last]))

    assert abs(response(20.0)) == pytest.approx(2**-0.5, rel=0.02)
    assert abs(response(40.0)) == pytest.approx((1 + 2**12) ** -0.5, rel=0.05)
    slow = response(2.0)
    assert abs(slow) == pytest.approx(1.0, rel=1e-3)
    assert -np.angle(slow * 1j) / (2 * np.pi * 2.0) == pytest.approx(0.0307, rel=0.02)


def test_the_filter_settles_where_it_is_put(rig):
    filtered = LowPassFilter(rig.sensors[0].low_pass, rig.step)
    filtered.reset(0.1)
    for _ in range(100):
        assert filtered.value == pytest.approx(0.1, rel=1e-9)
        filtered.advance(0.1)


def test_the_filter_gives_the_filtered_signal_of_the_records(experiments, rig):
    for experiment in experiments.values():
        filtered = LowPassFilter(rig.sensors[0].low_pass, experiment.sampling_time)
        filtered.reset(float(experiment.output[0]))
        values = np.empty(len(experiment.output))
        for k, y in enumerate(experiment.output):
            values[k] = filtered.value
            filtered.advance(y)
        # A second lets the unknown start of the filter die away.
        np.testing.assert_allclose(values[1000:], experiment.filtered[1000:], rtol=0, atol=1e-6)
