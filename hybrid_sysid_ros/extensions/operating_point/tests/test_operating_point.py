"""Costs about a steady motion: Riccati's at the end of the horizon, and inputs that cost nothing there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from hybrid_sysid_ros.control import ControlProblem, ExactMpc
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.operating_point.operating_point import about
from hybrid_sysid_ros.extensions.operating_point.terminal_cost import riccati_terms
from hybrid_sysid_ros.extensions.shared.steady_motion import steady_motion
from hybrid_sysid_ros.support.errors import UserError
from tests.control.test_terms import ARMS
from tests.control.two_inputs import PROBLEM
from tests.one_joint import Linear
from tests.straight_beam import straight


def test_inputs_cost_nothing_at_an_operating_point():
    rest = about(ARMS, PROBLEM, [0.2, 0.0])
    found = pytest.importorskip("hybrid_sysid_ros.extensions.ipopt.interior_point")
    point = steady_motion(ARMS, rest, np.array([0.2, 0.0]))
    asked = point.state, np.zeros(2), point.inputs, np.tile([0.2, 0.0], (12, 1))
    for solver in (ExactMpc(ARMS, rest), found.InteriorPointMpc(ARMS, rest, tolerance=1e-9)):
        np.testing.assert_allclose(solver.control(*asked).inputs, np.tile(rest.input_rest, (12, 1)), atol=1e-5)
    assert np.abs(ExactMpc(ARMS, PROBLEM).control(*asked).inputs[-1] - point.inputs).max() > 1e-3
    with pytest.raises(UserError, match="no inputs hold the outputs at"):
        about(ARMS, PROBLEM, [2.0, 0.0])
    with pytest.raises(UserError, match=r"first_torque would be .*, beyond its bounds -0\.01 and 0\.01"):
        about(ARMS, replace(PROBLEM, input_low=(-0.01,), input_high=(0.01,)), [0.2, 0.0])


def test_an_input_may_rest_at_its_bound():
    """Rounding leads beyond it; of several beyond their bounds the furthest is named."""
    point = steady_motion(ARMS, PROBLEM, np.array([0.2, 0.0])).inputs
    about(ARMS, replace(PROBLEM, input_low=tuple(point + 1e-14)), [0.2, 0.0])
    furthest = str(ARMS.inputs[int(np.argmax(np.abs(point)))]).split()[0]
    with pytest.raises(UserError, match=f"{furthest} would be"):
        about(ARMS, replace(PROBLEM, input_low=(-1e-3,), input_high=(1e-3,)), [0.2, 0.0])


@dataclass(frozen=True, kw_only=True)
class Basin(System):
    """x' = pump + 2 spring - x: two inputs for one level."""

    states = ("level [m]",)
    inputs = ("pump [m/s]", "spring [m/s]")

    def law(self, x, u):
        return (u[0] + 2.0 * u[1] - x[0],)


@pytest.mark.parametrize(
    ("weights", "most", "expected"),
    [((1.0, 1.0), 10.0, (0.2, 0.4)), ((1.0, 4.0), 10.0, (0.5, 0.25)), ((1.0, 1.0), 0.3, (0.4, 0.3))],
)
def test_of_the_inputs_that_hold_an_output_the_cheapest_within_their_bounds_are_taken(weights, most, expected):
    """Level 1 needs pump + 2 spring = 1: by Lagrange, spring / pump = 2 R_pump / R_spring."""
    problem = ControlProblem(
        horizon=5,
        period=0.1,
        substeps=1,
        output_weights=(1.0,),
        input_weights=weights,
        input_low=(0.0,),
        input_high=(10.0, most),
    )
    assert about(Basin(), problem, [1.0]).input_rest == pytest.approx(expected, abs=1e-6)


def test_with_riccati_s_cost_a_short_horizon_acts_as_a_long_one():
    system = straight(Linear(gain=5.0, centre=0.8, stiffness=15.0, damping=25.0, input_delay=0.0))
    long = ControlProblem(
        horizon=120,
        period=0.02,
        substeps=4,
        output_weights=(100.0,),
        output_scales=(0.02,),
        rate_weights=(1.0,),
        input_low=(-1e6,),
        input_high=(1e6,),
    )
    short = replace(long, horizon=3)
    ended = replace(short, terms=riccati_terms(system, short, np.array([0.01])))
    asked = np.array([0.02, 0.05]), np.zeros(1), np.array([1.5])
    first = [
        ExactMpc(system, each).control(*asked, np.full((each.horizon, 1), 0.01)).input[0]
        for each in (long, ended, short)
    ]
    assert first[1] == pytest.approx(first[0], abs=1e-4)
    assert abs(first[2] - first[0]) > 0.01
    with pytest.raises(UserError, match=r"riccati_at has shape \(2,\); give 1 outputs"):
        riccati_terms(system, short, np.zeros(2))
