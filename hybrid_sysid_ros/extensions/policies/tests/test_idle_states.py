"""States that change neither what is tracked nor how: a policy is not asked about them."""

import numpy as np

from hybrid_sysid_ros import models
from hybrid_sysid_ros.extensions.policies.idle_states import without_idle
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration


def test_only_the_difference_of_the_angles_is_left_of_them():
    rig, model = rigs.load("flexible_joint"), models.load(configuration.shipped("flexible_joint", "model"))
    problem = configuration.mpc_problem(configuration.defaults("flexible_joint", "controller"), rig, model.system)
    still = without_idle(model.system, problem)
    state = np.array([7.0, 6.9, 0.3, 0.2, 0.001])
    np.testing.assert_allclose(still @ state, [0.0, -0.1, 0.3, 0.2, 0.001], atol=1e-9)


def test_where_everything_matters_nothing_is_taken_away():
    beam = rigs.load("cam_beam")
    problem = configuration.mpc_problem(configuration.defaults("cam_beam", "controller"), beam)
    np.testing.assert_array_equal(without_idle(beam.system, problem), np.eye(2))
