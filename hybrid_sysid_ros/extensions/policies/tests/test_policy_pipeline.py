"""From a model to a controller in C, of any system: train, check, certify, export. Tiny, so that it is quick."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.control import ControlProblem, ExactMpc, Status
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.policy.training_settings import Settings
from hybrid_sysid_ros.control.safety.supervisor import Supervisor, Tolerances
from hybrid_sysid_ros.extensions.policies.counting import certify
from hybrid_sysid_ros.extensions.policies.criteria import Criteria
from hybrid_sysid_ros.extensions.policies.mixture import Mixture
from hybrid_sysid_ros.extensions.policies.tests.test_samples import CARTS_SPREAD
from hybrid_sysid_ros.extensions.policies.trial import Trial
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import Spread
from hybrid_sysid_ros.models import storage
from tests.linear_policies import CARTS
from tests.small_policies import SEAL, model_of

BEAM = ControlProblem(
    horizon=8,
    period=0.02,
    substeps=4,
    output_weights=(100.0,),
    output_scales=(0.0227,),
    rate_weights=(1.0,),
    input_low=(-10.0,),
    input_high=(10.0,),
    smoothing=0.005,
)
JOINT = ControlProblem(
    horizon=12,
    period=0.02,
    substeps=4,
    output_weights=(100.0,),
    rate_weights=(1.0,),
    input_low=(-2.0,),
    input_high=(3.0,),
    rate_limits=(0.8,),
    smoothing=0.05,
)


@pytest.fixture(scope="module", params=["carts", "joint"])
def made(request, rig, flexible_joint, tmp_path_factory):
    """System, problem and spread, and the folder of a policy that was trained for them."""
    training = pytest.importorskip("hybrid_sysid_ros.extensions.policies.training", exc_type=ImportError)
    system, problem, spread = {
        "beam": (rig.system, BEAM, Spread(amplitude=(0.05,), disturbance=(0.3,), push=(0.005, 0.05))),
        "carts": (CARTS.system, CARTS.problem, CARTS_SPREAD),
        "joint": (flexible_joint, JOINT, Spread(amplitude=(0.2,), disturbance=(0.1,), push=(0.02, 0.02, 0.2, 0.2))),
    }[request.param]
    settings = Settings(episodes=(6, 4), hidden=(24,), epochs=40, batch=128, workers=1)
    model = dataclasses.replace(model_of(SEAL), system=system)
    place = tmp_path_factory.mktemp(request.param) / "policy"
    training.train(model, problem, spread, settings, seed=3).save(place)
    return system, problem.sized(system), spread, place


def test_what_was_trained_is_supervised(made):
    system, problem, _, place = made
    policy = policies.load(place)
    tolerances = Tolerances(cost=10.0, floor=1e6, violation=1e3, disturbance=(np.inf,), patience=0)
    supervisor = Supervisor(policy, ExactMpc(system, problem), tolerances)
    rest, held = np.zeros(policy.states), np.clip(0.0, problem.input_low, problem.input_high)
    statuses = []
    for _ in range(4):
        plan = supervisor.control(rest, np.zeros(policy.inputs), held, np.zeros((policy.horizon, policy.outputs)))
        statuses.append(plan.status)
        supervisor.prepare(problem.period)
    assert statuses[0] is Status.SOLVED
    assert set(statuses[1:]) == {Status.POLICY}


def test_what_was_trained_is_certified(made):
    """It keeps its bounds; so small a network keeps little else. The supervised one costs no more than the network."""
    system, problem, spread, place = made
    policy = policies.load(place)
    eta = tuple(0.1 * (np.array(problem.input_high) - np.array(problem.input_low)))
    trial = Trial(
        policy=policy,
        seal=storage.digest(place, kind="policy"),
        plant=system,
        model=system,
        mixture=Mixture(
            spread=spread,
            seconds=2 * problem.horizon * problem.period,
            state_error=(1e-4,),
            disturbance_error=(0.01,),
            plant="the model",
        ),
        criteria=Criteria(input_error=eta, cost_share=0.05, cost_floor=0.1, tracking_error=(0.1,)),
        tolerances=Tolerances(cost=0.05, floor=0.1, violation=1e-3, disturbance=(1.0,), patience=3),
    )
    found = certify(trial, loops=8, workers=1)
    found.save(place)
    certificate = policies.load(place).certificate
    assert certificate is not None
    assert certificate.rates == found.rates
    failed = {driver: certificate.failed[driver]["mixture"] for driver in ("network", "supervised")}
    assert failed["network"]["bounds"] == failed["supervised"]["bounds"] == 0
    assert failed["supervised"]["cost"] <= failed["network"]["cost"]


def test_what_was_trained_is_the_same_in_c(made, tmp_path):
    compiler = pytest.importorskip("hybrid_sysid_ros.extensions.export.compiler")
    folder = pytest.importorskip("hybrid_sysid_ros.extensions.export.policy_folder")
    if not compiler.found():
        pytest.skip("needs a C compiler: cc, gcc or clang")
    (check,) = folder.export(made[-1], tmp_path / "out", form="c")
    assert check.largest_difference is not None
    assert check.largest_difference < 1e-12
