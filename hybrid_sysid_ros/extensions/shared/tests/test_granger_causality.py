"""An output leads an input under feedback alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from hybrid_sysid_ros.extensions.shared.granger_causality import leads

STEP = 0.01


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
