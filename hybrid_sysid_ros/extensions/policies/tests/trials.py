"""Trials of policies of linear problems, whose exact law is known, and of shipped ones."""

import dataclasses
import math

from hybrid_sysid_ros.control.safety.supervisor import Tolerances
from hybrid_sysid_ros.extensions.policies.configured import trial_of as configured_trial
from hybrid_sysid_ros.extensions.policies.criteria import Criteria
from hybrid_sysid_ros.extensions.policies.mixture import Mixture
from hybrid_sysid_ros.extensions.policies.trial import Trial
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import Spread
from hybrid_sysid_ros.runtime import configuration
from tests.linear_policies import BEAM, CARTS
from tests.straight_beam import straight

STRAIGHT = straight(BEAM.system)
VOLT = 0.0227
MIXTURE_OF_BEAM = Mixture(
    spread=Spread(amplitude=(2.0 * VOLT,), disturbance=(0.4,), push=(0.01, 0.1), parameters=0.1),
    seconds=0.3,
    state_error=(2e-4, 0.01),
    disturbance_error=(0.05,),
    plant="the model",
)
CRITERIA = Criteria(input_error=(0.05,), cost_share=0.05, cost_floor=0.01, tracking_error=(0.05 * VOLT,))
TOLERANCES = Tolerances(cost=0.05, floor=1.0, violation=1e-3, disturbance=(math.inf,), patience=3)
TWO = Mixture(
    spread=Spread(amplitude=(0.4, 0.0, 0.2), disturbance=(0.4, 0.2), push=(0.02, 0.02, 0.1, 0.1), parameters=0.1),
    seconds=1.0,
    state_error=(1e-3,),
    disturbance_error=(0.05,),
    plant="the model",
)


def trial_of(policy, *, seed=0, plant=STRAIGHT):
    """A policy of the beam on a beam with nothing bent, or one of the carts on carts."""
    carts = policy.inputs == 2
    return Trial(
        policy=policy,
        seal="a policy",
        plant=CARTS.system if carts else plant,
        model=CARTS.system if carts else BEAM.system,
        mixture=TWO if carts else MIXTURE_OF_BEAM,
        criteria=dataclasses.replace(CRITERIA, tracking_error=(0.01,)) if carts else CRITERIA,
        tolerances=TOLERANCES,
        seed=seed,
    )


def trial_of_shipped(name):
    return configured_trial(configuration.shipped(name, "policy"), None)
