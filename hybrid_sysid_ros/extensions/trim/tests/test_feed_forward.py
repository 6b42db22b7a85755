"""Feed-forward of a model: a course that it asks for is one that the model flies."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.core.symbolic import symbolic_rates
from hybrid_sysid_ros.extensions.trim.equilibrium import equilibrium
from hybrid_sysid_ros.extensions.trim.feed_forward import scheduled
from hybrid_sysid_ros.rigs.feedback import Feedback
from hybrid_sysid_ros.rigs.rig import load
from hybrid_sysid_ros.support.errors import UserError

RIG = load("winged_cone")
GIVEN = RIG.experiments.feedback
assert GIVEN is not None
FEEDBACK: Feedback = GIVEN
KNOWN_AIR: Any = RIG.structures["known_air"]
MODEL = replace(KNOWN_AIR, density=1.02, mass=134_000.0)


def test_values_that_are_held_are_an_equilibrium():
    """A metre per second faster and ten metres higher, from where the model is at rest."""
    found, made = equilibrium(MODEL), scheduled(FEEDBACK, MODEL)
    course = np.array([1.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    states, inputs = found.states.copy(), found.inputs + made.forward @ course
    states[[0, 1, 2, 3, 4]] += made.wanted @ course
    states[5] += (made.forward @ course)[0]
    rates = np.array(symbolic_rates(MODEL)(states, inputs)[0]).ravel()
    np.testing.assert_allclose(rates, 0.0, atol=1e-5)


def test_the_frozen_model_has_the_feed_forward_of_the_file():
    """Which neglects what drag there is of speed, and third derivatives."""
    own, made = FEEDBACK, scheduled(FEEDBACK, RIG.structures["constant_air"])
    large = np.abs(own.forward) > 1e-6
    np.testing.assert_allclose(made.forward[large], own.forward[large], rtol=0.02)
    np.testing.assert_allclose(made.wanted[own.wanted > 0.0], own.wanted[own.wanted > 0.0], rtol=0.01)


def test_outputs_that_inputs_cannot_hold_are_refused():
    with pytest.raises(UserError, match="can't hold the followed outputs"):
        scheduled(replace(FEEDBACK, followed=(0, 1)), MODEL)
