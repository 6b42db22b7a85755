"""A controller that has answered once compiles nothing later: in a loop that would take seconds."""

import math

import numpy as np
import pytest

from hybrid_sysid_ros.control import ControlProblem, ExactMpc, Status
from tests.compiling import compiled_functions

PROBLEM = ControlProblem(
    horizon=10,
    period=0.02,
    substeps=2,
    output_weights=(1000.0,),
    rate_weights=(0.01,),
    input_low=(-5.0,),
    input_high=(5.0,),
    smoothing=0.01,
)
REST, NOTHING = np.zeros(2), np.zeros(1)
FAR = np.linspace(0.1, 0.5, 10)[:, None]


@pytest.mark.parametrize("real_time", [False, True])
def test_what_is_late_lost_or_begun_again_needs_nothing_new(slider, real_time):
    now = 0.0

    def clock():
        nonlocal now
        now += 1.0
        return now

    mpc = ExactMpc(slider, PROBLEM, real_time=real_time, time_limit=math.inf, clock=clock)
    mpc.control(REST, NOTHING, NOTHING, np.zeros((10, 1)))
    mpc.prepare(0.02)
    compiled = compiled_functions()
    assert mpc.control(REST, NOTHING, NOTHING, FAR).status in (Status.SOLVED, Status.ITERATED)
    assert mpc.control(np.array([math.nan, 0.0]), NOTHING, NOTHING, FAR).status is Status.FAILED
    mpc.reset()
    late = ExactMpc(slider, PROBLEM, real_time=real_time, time_limit=0.5, tolerance=1e-15, clock=clock)
    assert late.control(REST, NOTHING, NOTHING, FAR).status is Status.LATE
    assert compiled_functions() == compiled
