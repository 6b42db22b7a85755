"""The certificate: a law that is exact passes, a broken share is found as that share, and a seed decides all."""

import dataclasses
import math

import numpy as np
import pytest
from hybrid_sysid_ros.control.policy.sampling import Spread
from hybrid_sysid_ros.control.safety.certified_loop import COST, ERROR, EXACT, EXCESS, NETWORK, SUPERVISED, UNSOLVED
from hybrid_sysid_ros.control.safety.certified_policy import KKT_TOLERANCE, Criteria, Distribution, Subject
from linear_policies import FEATURES, LINEAR, broken_policy, exact_policy  # type: ignore[import-not-found]
from scipy.stats import binom

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.safety import certificate as certificates
from hybrid_sysid_ros.control.safety.certificate import FILE, LEAST_LOOPS, binomial_bound, margin
from hybrid_sysid_ros.control.safety.certification import certify
from hybrid_sysid_ros.control.safety.online_check import REASONS, Tolerances
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.core import stepped
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError
from tests.straight_beam import straight

STRAIGHT = straight(LINEAR)
DISTRIBUTION = Distribution(
    spread=Spread(amplitude=2.0, disturbance=0.4, input_jitter=0.0, kick=(0.01, 0.1), parameters=0.1),
    seconds=0.3,
    state_error=(2e-4, 0.01),
    disturbance_error=0.05,
    plant="the model",
)
CRITERIA = Criteria(input_error=0.05, cost_share=0.05, cost_floor=0.01)
TOLERANCES = Tolerances(cost=0.05, floor=1.0, violation=1e-3, disturbance=math.inf, patience=3)


def subject_of(policy, *, seed=0, plant=STRAIGHT, **changes):
    return Subject(
        policy=policy,
        seal="a policy",
        plant=plant,
        model=LINEAR,
        distribution=DISTRIBUTION,
        criteria=CRITERIA,
        tolerances=TOLERANCES,
        seed=seed,
        **changes,
    )


@pytest.fixture(scope="module")
def law():
    return exact_policy()


@pytest.fixture(scope="module")
def broken():
    return broken_policy()


# The statement


def test_the_margin_is_hoeffding_s():
    assert margin(1000, 0.05) == pytest.approx(math.sqrt(math.log(40.0) / 2000.0), rel=1e-12)
    assert margin(LEAST_LOOPS, 0.01) <= 0.01 < margin(LEAST_LOOPS - 1, 0.01)  # Hertneck et al. (2018)


def test_the_exact_law_of_a_linear_problem_passes_every_loop(law):
    found = certify(subject_of(law), loops=300, workers=1)
    for driver in ("network", "supervised"):
        assert found.rates[driver] == {"input": 1.0, "bounds": 1.0, "cost": 1.0, "all": 1.0}
        assert found.bounds["hoeffding"][driver]["all"] == 1.0 - margin(300, 0.01)
        assert found.mu(driver) == pytest.approx(0.01 ** (1 / 300))
    first = 1.0 / 15.0  # of the periods: there the exact MPC makes the first plan
    assert found.check["accepted"] + found.check["waiting for good answers"] == 1.0
    assert found.check["waiting for good answers"] == pytest.approx(first)
    assert found.exact["not_converged"] == 0.0
    assert max(case["input_error"] for case in found.worst) < 0.01


def test_a_law_that_is_broken_on_a_share_of_the_loops_passes_the_others(broken):
    """Which loops those are follows from what they are made of, not from how they went."""
    subject = subject_of(broken)
    draws = [subject.draw(loop) for loop in range(400)]
    sound = [np.all(draw.disturbances + draw.errors[:, 2] <= 0.0) for draw in draws]
    found = certify(subject, loops=400, workers=1)
    assert 0.2 < np.mean(sound) < 0.8
    assert found.rates["network"]["input"] == np.mean(sound)
    assert found.rates["network"]["all"] == np.mean(sound)
    assert found.bounds["hoeffding"]["network"]["all"] == np.mean(sound) - margin(400, 0.01)


def test_the_exact_bound_is_that_of_the_binomial_distribution():
    """With no failure it has a closed form; with some, the chance of so few at the bound is delta."""
    assert binomial_bound(26_492, 26_492, 0.01) == pytest.approx(0.01 ** (1 / 26_492), abs=1e-12)
    assert binomial_bound(0, 50, 0.01) == 0.0
    for failed in (1, 7, 60):
        bound = binomial_bound(1000 - failed, 1000, 0.01)
        assert binom.cdf(failed, 1000, 1.0 - bound) == pytest.approx(0.01, rel=1e-6)


def test_the_supervisor_catches_what_is_broken(broken):
    """Plans that are 5 V off are costlier than what is left of the last one, so the exact MPC drives."""
    found = certify(subject_of(broken), loops=200, workers=1)
    assert found.rates["supervised"]["all"] > found.rates["network"]["all"] + 0.2
    assert found.check["costlier than the shifted plan"] > 0.1
    assert sum(found.check.values()) == pytest.approx(1.0)


def test_a_worst_case_can_be_run_again(broken):
    subject = subject_of(broken)
    found = certify(subject, loops=100, workers=1)
    worst = next(case for case in found.worst if case["driver"] == "network" and case["by"] == "input")
    _, track = subject.again(worst["loop"], "network")
    errors = np.abs(track.inputs - track.exact)
    assert int(np.argmax(errors)) == worst["period"]
    assert errors.max() == worst["input_error"]


# The same loops


def test_a_seed_decides_a_certificate(broken):
    subject = subject_of(broken)
    one, two = (certify(subject, loops=130, workers=workers) for workers in (1, 2))
    other = certify(subject_of(broken, seed=1), loops=130, workers=1)
    for field in ("rates", "check", "exact", "worst", "distribution", "criteria"):
        assert getattr(one, field) == getattr(two, field)
    assert one.worst != other.worst


def test_an_interrupted_certification_goes_on(broken, tmp_path):
    subject, store, told = subject_of(broken), tmp_path / "half", []

    def interrupt(stage, done, of):
        told.append(done)
        if done >= 64:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(subject, loops=300, workers=1, store=store, progress=interrupt)
    begun = []
    found = certify(subject, loops=300, workers=1, store=store, progress=lambda stage, done, of: begun.append(done))
    assert begun[0] == told[-1] >= 64  # the last word is what is kept
    assert begun[-1] == 300
    assert not store.exists()
    whole = certify(subject, loops=300, workers=1)
    assert (found.rates, found.worst) == (whole.rates, whole.worst)


def test_loops_of_another_seed_are_not_taken_for_these(broken, tmp_path):
    store = tmp_path / "half"

    def interrupt(stage, done, of):
        if done >= 32:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(subject_of(broken, seed=3), loops=100, workers=1, store=store, progress=interrupt)
    begun = []
    certify(subject_of(broken), loops=100, workers=1, store=store, progress=lambda stage, done, of: begun.append(done))
    assert begun[0] == 0


# The compiled loop


def by_hand(subject, draw, driver):
    """A loop of ordinary objects: inputs, the exact MPC's answers beside them, states, cost, what the check found."""
    problem, policy = subject.policy.problem, subject.policy
    judge, own = (ExactMpc(subject.model, problem, tolerance=KKT_TOLERANCE) for _ in range(2))
    drives = {EXACT: judge, NETWORK: policy, SUPERVISED: Supervisor(policy, own, subject.tolerances)}[driver]
    plant, step = subject.plant.with_values(draw.parameters), problem.period / problem.substeps
    plant = plant.with_weights(draw.network)
    x, u, cost = draw.state.copy(), draw.input.copy(), 0.0
    inputs, exact, states = [], [], [x.copy()]
    for k, disturbance in enumerate(draw.disturbances):
        x = x + draw.pushes[k]
        question = (x + draw.errors[k, :2], np.array([disturbance + draw.errors[k, 2]]), u, draw.wanted[k : k + 8])
        answer = judge.control(*question)
        judge.prepare(problem.period)
        given = answer if drives is judge else drives.control(*question)
        if drives is not judge:
            drives.prepare(problem.period)
        cost += problem.rate_weight * (given.input[0] - u[0]) ** 2
        u = given.input.copy()
        for _ in range(problem.substeps):
            x = stepped(plant, x, u + disturbance, step=step)
        cost += problem.output_weight * ((x[0] - draw.wanted[k]) / problem.output_scale) ** 2
        inputs.append(u[0])
        exact.append(answer.input[0])
        states.append(x.copy())
    return np.array(inputs), np.array(exact), np.array(states), cost, getattr(drives, "reasons", {})


@pytest.mark.parametrize("driver", [EXACT, NETWORK, SUPERVISED])
def test_the_compiled_loop_is_the_loop_of_ordinary_objects(broken, rig, driver):
    """On a plant that is not the model: the beam with its friction, under the MPC of a linear one."""
    subject = dataclasses.replace(
        subject_of(broken, plant=rig.system), criteria=dataclasses.replace(CRITERIA, input_error=math.inf)
    )
    bench = subject.bench()
    for loop in range(12):
        draw = subject.draw(loop)
        measures, reasons = np.zeros(5), np.zeros(len(REASONS), np.int64)
        track = bench.run(draw, driver, measures, reasons)
        inputs, exact, states, cost, counted = by_hand(subject, draw, driver)
        np.testing.assert_allclose(track.inputs, inputs, atol=1e-9)
        np.testing.assert_allclose(track.exact, exact, atol=1e-9)
        np.testing.assert_allclose(track.states, states, atol=1e-11)
        assert measures[COST] == pytest.approx(cost, rel=1e-9)
        assert measures[ERROR] == pytest.approx(np.max(np.abs(inputs - exact)), abs=1e-9)
        assert measures[EXCESS] == measures[UNSOLVED] == 0.0
        assert {REASONS[k]: n for k, n in enumerate(reasons) if n} == counted


def test_a_network_that_gives_no_numbers_keeps_its_bounds_and_no_loop(law):
    weights = [tuple(np.full_like(part, np.nan) for part in layer) for layer in law.layers]
    found = certify(subject_of(dataclasses.replace(law, layers=tuple(weights))), loops=40, workers=1)
    assert found.rates["network"]["bounds"] == 1.0
    assert found.rates["network"]["cost"] < 0.5
    assert found.rates["supervised"]["all"] == 1.0  # the exact MPC drives
    assert found.check["accepted"] == 0.0
    assert found.check["out of range"] == pytest.approx(14.0 / 15.0)


def test_the_exact_mpc_is_asked_again_from_the_network_s_plan_where_they_differ(law):
    """Where it finds nothing cheaper there, the difference stands."""
    subject = subject_of(law)
    shifted = dataclasses.replace(law, layers=(law.layers[0], (law.layers[1][0], law.layers[1][1] + 0.01)))  # 1 V
    found = certify(dataclasses.replace(subject, policy=shifted), loops=20, workers=1)
    assert found.rates["network"]["input"] == 0.0
    assert found.worst[0]["input_error"] == pytest.approx(1.0, abs=0.02)


# The file


@pytest.fixture
def certified(law, tmp_path):
    features = np.random.default_rng(0).normal(scale=0.01, size=(3, FEATURES))
    policy = dataclasses.replace(law, check=(features, law.evaluate(features)))
    folder = tmp_path / "policy"
    policy.save(folder)
    seal = storage.digest(folder, kind="policy")
    found = certify(dataclasses.replace(subject_of(policy), seal=seal), loops=40, workers=1)
    found.save(folder)
    return folder, seal, found


def test_a_certificate_survives_a_round_trip(certified):
    folder, seal, found = certified
    back = certificates.find(folder, policy=seal, model="5ea1")
    assert back is not None
    assert (back.rates, back.loops, back.delta) == (found.rates, 40, 0.01)
    assert back.bounds == found.bounds


def test_a_policy_is_loaded_with_its_certificate_or_without_one(certified):
    folder, _, found = certified
    loaded = policies.load(folder).certificate
    assert loaded is not None
    assert loaded.rates == found.rates
    assert policies.load(folder, certified=False).certificate is None
    (folder / FILE).unlink()
    assert policies.load(folder).certificate is None


def test_a_certificate_that_was_altered_or_is_another_s_is_refused(certified):
    folder, seal, _ = certified
    with pytest.raises(UserError, match=r"certificate\.yaml: belongs to another policy"):
        certificates.find(folder, policy="another", model="5ea1")
    with pytest.raises(UserError, match=r"certificate\.yaml: belongs to another model"):
        certificates.find(folder, policy=seal, model="another")
    path = folder / FILE
    path.write_text(path.read_text().replace("loops: 40", "loops: 40000"))
    again = r"restore it or make the certificate again \(hybrid-sysid policy certify\)"
    with pytest.raises(UserError, match=rf"certificate\.yaml: was altered since it was saved; {again}"):
        policies.load(folder)
    path.write_text("loops: [")
    with pytest.raises(UserError, match="can't be read as YAML"):
        certificates.find(folder, policy=seal, model="5ea1")


def test_a_policy_that_changed_meanwhile_is_not_certified(certified, law):
    folder, _, found = certified
    features = np.random.default_rng(1).normal(scale=0.01, size=(3, FEATURES))
    dataclasses.replace(law, check=(features, law.evaluate(features))).save(folder)
    assert not (folder / FILE).exists()  # a new policy has none
    with pytest.raises(UserError, match="another policy than the one that was certified"):
        found.save(folder)


def test_a_certificate_of_another_policy_is_refused_when_that_is_loaded(certified, law, tmp_path):
    folder, _, _ = certified
    features = np.random.default_rng(1).normal(scale=0.01, size=(3, FEATURES))
    dataclasses.replace(law, check=(features, law.evaluate(features))).save(tmp_path / "other")
    (tmp_path / "other" / FILE).write_bytes((folder / FILE).read_bytes())
    with pytest.raises(UserError, match="belongs to another policy; certify it again") as refusal:
        policies.load(tmp_path / "other")
    assert "\n" not in str(refusal.value)


# What can't be certified


def test_a_policy_of_first_inputs_and_strange_numbers_are_refused(law):
    first = dataclasses.replace(law, layers=(law.layers[0], tuple(part[:1] for part in law.layers[1])))
    with pytest.raises(UserError, match="gives 1 of the 8 inputs of a plan"):
        certify(subject_of(first), loops=10)
    for loops, delta in ((0, 0.01), (10, 0.0), (10, 1.0), (10, math.nan)):
        with pytest.raises(UserError, match="say nothing"):
            certify(subject_of(law), loops=loops, delta=delta)


def test_a_plant_of_other_states_is_refused(law, flexible_joint):
    with pytest.raises(UserError, match="the plant's states"):
        subject_of(law, plant=flexible_joint)
