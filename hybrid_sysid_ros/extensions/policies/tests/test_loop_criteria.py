"""The criteria of a loop, each of which can fail."""

import dataclasses
import math

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.policies.criteria import (
    COST,
    ERROR,
    EXCESS,
    MEASURES,
    NETWORK,
    TRACKING,
    TRAVEL,
    VALIDITY,
)
from hybrid_sysid_ros.extensions.policies.tests.trials import CRITERIA, trial_of_shipped


@pytest.mark.parametrize("name", ["input", "bounds", "cost", "settled", "travel", "validity"])
def test_every_criterion_can_fail(name):
    """Each by the measure of its own, beside an exact MPC that keeps them all."""
    criteria = dataclasses.replace(CRITERIA, travel=((-1.0,), (1.0,)), validity=((-1.0,), (1.0,)))
    measures = np.zeros((1, 3, len(MEASURES)))
    broken = {"input": ERROR, "bounds": EXCESS, "cost": COST, "settled": TRACKING, "travel": TRAVEL}
    measures[0, NETWORK, broken.get(name, VALIDITY)] = 2.0
    kept = criteria.kept(measures, 10, 1e-3)
    assert [key for key, values in kept["network"].items() if not values[0]] == [name, "all"]
    assert all(values[0] for values in kept["supervised"].values())


def test_a_state_outside_of_travel_or_no_number_is_found():
    criteria = dataclasses.replace(CRITERIA, travel=((-1.0, -math.inf), (1.0, math.inf)))
    assert criteria.outside(np.array([[0.5, 9.0], [-1.25, 0.0]])) == (0.25, 0.0)
    assert criteria.outside(np.array([[0.5, math.nan]])) == (math.inf, 0.0)


@pytest.mark.parametrize("name", ["cam_beam", "winged_cone", "wheel_motor"])
def test_the_criteria_of_a_rig_are_those_that_it_can_fail(name):
    criteria = trial_of_shipped(name).criteria
    assert (criteria.travel is not None) == (name == "cam_beam")
    assert (criteria.validity is not None) == (name == "winged_cone")
