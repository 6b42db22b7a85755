"""Records for tests of the check: a good one, and steps that drive a lag."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros import bags

ROOT = Path(__file__).parents[4]
RIG = "wheel_motor"
STEPS = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 60), 50)


@cache
def record():
    return bags.read(ROOT / "bags" / "wheel_motor_multisine", hs.load_rig(RIG).signals)


def driven_lag(values):
    """T y' = u - y with T of 20 samples, and a little noise."""
    lag = lfilter([0.05], [1.0, -0.95], values)
    return lag + 0.003 * np.ptp(lag) * np.random.default_rng(1).normal(size=len(lag))
