"""The policy that ships with the package: it imitates, and it tracks on the noisy plant."""

import numpy as np
import pytest

from hybrid_sysid_ros import models
from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.closed_loop import simulate_loop
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.runtime import configuration


@pytest.fixture(scope="module")
def shipped():
    model = models.load(configuration.shipped("cam_beam", "model"))
    return model, policies.load(configuration.shipped("cam_beam", "policy"), model=model)


def test_the_shipped_policy_is_of_the_rig_s_problem(shipped, rig):
    model, policy = shipped
    values = configuration.defaults("cam_beam", "controller")
    assert policy.problem == configuration.mpc_problem(values, rig, model.system)


def test_the_shipped_policy_imitates_the_exact_mpc_of_the_shipped_model(shipped):
    model, policy = shipped
    expert = ExactMpc(model.system, policy.problem)
    vectors = pytest.importorskip("hybrid_sysid_ros.extensions.export.vectors")
    known = len(policy.check[1])
    errors = []
    asked = vectors.parts(policy, vectors.vectors(policy).instances)
    for *instance, _ in zip(*(part[:known] for part in asked), strict=True):
        expert.reset()
        for _ in range(2):  # from a cold start some need more iterations than a call has
            exact = expert.control(*instance)
        errors.append(policy.control(*instance).input[0] - exact.input[0])
    assert np.sqrt(np.mean(np.square(errors))) < 0.1


def test_the_shipped_policy_tracks_the_author_s_reference(shipped, rig):
    """On the noisy plant at 200 Hz: at most .42 V on the steps and .05 V on the sine; the rig: 1.080 and .500."""
    model, policy = shipped
    tuning = configuration.estimator_tuning(configuration.defaults("cam_beam", "estimator"), rig)
    latency, scale, schedule = 0.001, rig.display[0].scale, rig.schedule()
    loop = simulate_loop(
        Plant(rig, seed=5, bias=0.03),
        ExtendedKalmanFilter(model.system, tuning, period=0.005, latency=latency),
        policy,
        lambda times: scale * schedule(times),
        inputs=1,
        duration=51.0,
        period=0.005,
        lead=model.system.delay + latency,
    )
    assert loop.tracking_rmse(0.0, 29.0)[0] / scale <= 0.42
    assert loop.tracking_rmse(30.0, 50.0)[0] / scale <= 0.05
    at_rest = np.mean(loop.outputs[loop.time > 50.7]) / scale
    assert at_rest == pytest.approx(0.0, abs=0.05)
    assert loop.statuses == {Status.POLICY: 10_200}
    assert np.max(np.abs(loop.inputs)) <= rig.actuators[0].high
