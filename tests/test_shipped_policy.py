"""The policy that ships with the package: it imitates, and it tracks on the noisy plant."""

import numpy as np
import pytest

from hybrid_sysid_ros import models
from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.closed_loop import run_loop
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.runtime import configuration


@pytest.fixture(scope="module")
def shipped():
    model = models.load(configuration.shipped("cam_beam", "model"))
    return model, policies.load(configuration.shipped("cam_beam", "policy"), model=model)


def test_the_shipped_policy_imitates_the_exact_mpc_of_the_shipped_model(shipped):
    model, policy = shipped
    expert = ExactMpc(model.system, policy.problem)
    errors = []
    for row in policy.check[0]:
        state, d, previous, preview = row[:2], row[2:3], row[3:4], row[4:] + row[0]
        expert.reset()
        for _ in range(2):  # from a cold start one question in eight needs more iterations than a call has
            exact = expert.control(state, d, previous, preview)
        errors.append(policy.control(state, d, previous, preview).input[0] - exact.input[0])
    assert np.sqrt(np.mean(np.square(errors))) < 0.1


def test_the_shipped_policy_tracks_the_author_s_reference(shipped, rig):
    """On the noisy plant at 200 Hz: at most .42 V on the steps and .05 V on the sine; the rig: 1.080 and .500."""
    model, policy = shipped
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    latency = 0.001
    loop = run_loop(
        Plant(rig, seed=5, bias=0.03),
        ExtendedKalmanFilter(model.system, tuning, period=0.005, latency=latency),
        policy,
        rig.schedule().of(0),
        duration=51.0,
        period=0.005,
        lead=model.system.delay + latency,
    )
    scale = rig.display[0].scale
    assert loop.tracking_rmse(0.0, 29.0) / scale <= 0.42
    assert loop.tracking_rmse(30.0, 50.0) / scale <= 0.05
    at_rest = np.mean(loop.position[loop.time > 50.7]) / scale
    assert at_rest == pytest.approx(0.0, abs=0.05)
    assert loop.statuses == {Status.POLICY: 10_200}
    assert np.max(np.abs(loop.input)) <= rig.actuators[0].high
