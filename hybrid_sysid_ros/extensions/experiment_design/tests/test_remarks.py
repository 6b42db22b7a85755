"""What records can show is said before any fit."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.experiment_design.remarks import remarks_of
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
