"""What records can show is said before any fit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.experiment_design.remarks import leads, remarks_of
from hybrid_sysid_ros.extensions.experiment_design.tests.test_design import NOISE, STEP, ValveLag, rig
from hybrid_sysid_ros.support.arrays import Array


def recorded(inputs: Array) -> Record:
    """Of a lag that begins at rest."""
    states = simulate(ValveLag(), np.zeros(1), inputs[1:, None], step=STEP)
    noise = NOISE * np.random.default_rng(0).normal(size=states.shape)
    times = np.arange(len(inputs), dtype=np.float64) * STEP
    return Record(name="lag", time=times, input=inputs[:, None], output=states + noise)


def test_an_input_far_below_its_corner_shows_the_gain_and_not_the_lag() -> None:
    """At w T = 1e-3 the lag moves the level by a thousandth of what the gain does."""
    times = np.arange(3001) * STEP
    lines = remarks_of([recorded(0.5 * np.sin(2e-3 * times))], rig())
    assert lines[0].startswith("these records hardly show lag:")
    assert "alone: gain 0.0" in lines[1]
    steps = np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, 61), 50)[:3001]
    lines = remarks_of([recorded(steps)], rig())
    assert len(lines) == 1
    assert "gain 0.00" in lines[0]
    assert "lag 0.00" in lines[0]


@pytest.mark.parametrize("hold", [1, 25])
@pytest.mark.parametrize("gain", [0.0, 0.4])
def test_an_output_leads_an_input_only_under_feedback(gain: float, hold: int) -> None:
    """y(k) = .9 y(k-1) + .2 u(k-1) + e(k), u(k) = r(k) - g y(k-1), which may be held for some samples."""
    random = np.random.default_rng(2)
    wanted, noise = lfilter([1.0], [1.0, -0.7], random.normal(size=12000)), random.normal(size=12000)
    y, u = np.zeros(12000), np.zeros(12000)
    for k in range(1, 12000):
        u[k] = u[k - 1] if k % hold else wanted[k] - gain * y[k - 1]
        y[k] = 0.9 * y[k - 1] + 0.2 * u[k - 1] + noise[k]
    assert leads(y, u) == (gain > 0.0)


def test_an_output_that_remembers_an_input_does_not_lead_it() -> None:
    """In an open loop: a band-limited input, of which 12 samples do not say all, levels, and a sweep with noise."""
    random = np.random.default_rng(3)
    smooth = sosfiltfilt(butter(2, [0.002, 0.1], "bandpass", output="sos"), random.normal(size=20000))
    steps = np.repeat(random.uniform(-1.0, 1.0, 150), random.integers(20, 180, 150))
    times = np.arange(4000) * STEP
    sweep = np.sin(2.0 * np.pi * (0.05 + 0.5 * 0.05 * times) * times)
    for drive, noise, other in ((smooth / np.std(smooth), 0.0, 3e-2), (steps, 2e-3, 3e-2), (sweep, 1e-3, 1e-3)):
        seen = drive + noise * random.normal(size=len(drive))
        output = lfilter([0.1], [1.0, -0.9], drive) + other * random.normal(size=len(drive))
        assert not leads(output, seen)
