"""The certificate: a law that is exact passes, a broken share is found as that share, and a seed decides all."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import binom

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.safety import certificate as certificates
from hybrid_sysid_ros.control.safety.certificate import DELTA, FILE, FORMAT, LOOPS, MIXTURE, binomial_bound
from hybrid_sysid_ros.control.safety.supervisor import REASONS, Supervisor, Tolerances
from hybrid_sysid_ros.control.scenarios import Spread
from hybrid_sysid_ros.core import one_step
from hybrid_sysid_ros.extensions.policies.configured import trial_of as configured_trial
from hybrid_sysid_ros.extensions.policies.counting import certify
from hybrid_sysid_ros.extensions.policies.criteria import (
    COST,
    DRIVERS,
    ERROR,
    EXACT,
    EXCESS,
    MEASURES,
    NETWORK,
    SUPERVISED,
    TRACKING,
    TRAVEL,
    VALIDITY,
    Criteria,
)
from hybrid_sysid_ros.extensions.policies.mixture import APART, DISTURBED, STRATA, Mixture, stratum_of
from hybrid_sysid_ros.extensions.policies.trial import KKT_TOLERANCE, Drivers, Trial
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_policies import BEAM, CARTS, broken_policy, checked, exact_policy
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


@pytest.fixture(scope="module")
def law():
    return exact_policy(BEAM)


@pytest.fixture(scope="module")
def broken():
    return broken_policy(BEAM)


# The statement


@pytest.mark.parametrize("case", [BEAM, CARTS], ids=["one input", "two inputs"])
def test_the_exact_law_of_a_linear_problem_passes_every_loop(case):
    loops = 120
    found = certify(trial_of(exact_policy(case)), loops=loops, workers=1)
    for driver in ("network", "supervised"):
        assert set(found.failed[driver][MIXTURE].values()) == {0}
        assert found.bounds[driver][MIXTURE] == pytest.approx((DELTA / found.statements) ** (1 / loops))
    counts = found.ledger[0]
    assert counts.check["waiting for good answers"] == loops  # in the first period the exact MPC makes the plan
    assert counts.check["accepted"] + loops == counts.exact["periods"]
    assert counts.exact["not_converged"] == 0
    assert max(worst["input_error"] for worst in found.worst) < 0.2


@pytest.mark.parametrize("case", [BEAM, CARTS], ids=["one input", "two inputs"])
def test_a_law_that_is_broken_on_a_share_of_the_loops_passes_the_others(case):
    """Which loops those are follows from what they are made of, not from how they went."""
    trial, loops = trial_of(broken_policy(case)), 160
    scenarios = [trial.scenario(loop) for loop in range(loops)]
    sound = [np.all(each.disturbances[:, 0] + each.disturbance_errors[:, 0] <= 0.0) for each in scenarios]
    found = certify(trial, loops=loops, workers=1)
    assert 0.2 < np.mean(sound) < 0.8
    assert loops - found.failed["network"][MIXTURE]["input"] == np.sum(sound)
    assert loops - found.failed["network"][MIXTURE]["all"] == np.sum(sound)
    bound = binomial_bound(int(np.sum(sound)), loops, DELTA / found.statements)
    assert found.bounds["network"][MIXTURE] == bound


def test_the_exact_bound_is_that_of_the_binomial_distribution():
    """With no failure it has a closed form; with some, the chance of so few at the bound is delta."""
    assert binomial_bound(LOOPS - 1, LOOPS - 1, DELTA) < 0.9999 <= binomial_bound(LOOPS, LOOPS, DELTA)
    assert binomial_bound(26_492, 26_492, 0.01) == pytest.approx(0.01 ** (1 / 26_492), abs=1e-12)
    assert binomial_bound(0, 50, 0.01) == 0.0
    for loops, failed, delta in ((1000, 1, 0.01), (1000, 60, 0.01), (17_472, 4, 1e-7), (20_000, 60, 1e-8)):
        bound = binomial_bound(loops - failed, loops, delta)
        assert binom.cdf(failed, loops, 1.0 - bound) == pytest.approx(delta, rel=1e-6)


def test_the_supervisor_catches_what_is_broken(broken):
    """Plans that are 5 V off are costlier than what is left of the last one, so the exact MPC drives."""
    found = certify(trial_of(broken), loops=100, workers=1)
    supervised, network = (found.rates[driver][MIXTURE]["all"] for driver in ("supervised", "network"))
    assert supervised > network + 0.2
    counts = found.ledger[0]
    assert counts.check["costlier than the shifted plan"] > 0.1 * counts.exact["periods"]
    assert sum(counts.check.values()) == counts.exact["periods"]


def test_a_worst_case_can_be_run_again(broken):
    trial = trial_of(broken)
    found = certify(trial, loops=60, workers=1)
    worst = next(case for case in found.worst if case["driver"] == "network" and case["by"] == "input")
    driven = trial.run(trial.scenario(worst["loop"]), NETWORK)
    errors = np.abs(driven.inputs - driven.exact)[:, 0] / CRITERIA.input_error[0]
    assert int(np.argmax(errors)) == worst["period"]
    assert errors.max() == worst["input_error"]


# The same loops


@pytest.mark.slow
def test_a_seed_decides_a_certificate(broken):
    subject = trial_of(broken)
    one, two = (certify(subject, loops=130, workers=workers) for workers in (1, 2))
    other = certify(trial_of(broken, seed=1), loops=130, workers=1)
    for field in ("failed", "bounds", "worst", "distribution", "criteria"):
        assert getattr(one, field) == getattr(two, field)
    assert one.worst != other.worst


def test_an_interrupted_certification_goes_on(broken, tmp_path):
    trial, store = trial_of(broken), tmp_path / "half"

    def interrupt(stage, done, of):
        if done >= 64:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(trial, loops=100, workers=1, store=store, progress=interrupt)
    assert len(list(store.iterdir())) == 2
    found = certify(trial, loops=100, workers=1, store=store)
    assert not store.exists()
    whole = certify(trial, loops=100, workers=1)
    assert (found.failed, found.worst) == (whole.failed, whole.worst)


def test_a_cluster_counts_what_processes_count(broken):
    pytest.importorskip("distributed")
    here, there = (certify(trial_of(broken), loops=40, workers=1, cluster=cluster) for cluster in ("", "local"))
    assert (here.failed, here.worst) == (there.failed, there.worst)


def test_loops_of_another_seed_are_not_taken_for_these(broken, tmp_path):
    store = tmp_path / "half"

    def interrupt(stage, done, of):
        if done >= 32:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(trial_of(broken, seed=3), loops=64, workers=1, store=store, progress=interrupt)
    found = certify(trial_of(broken), loops=64, workers=1, store=store)
    assert found.worst == certify(trial_of(broken), loops=64, workers=1).worst


# A loop


def by_hand(trial, scenario, driver):
    """A loop of ordinary objects: inputs, the exact MPC's answers beside them, states, cost, what the check found."""
    problem, policy = trial.policy.problem, trial.policy
    judge, own = (ExactMpc(trial.model, problem, tolerance=KKT_TOLERANCE) for _ in range(2))
    drives = {EXACT: judge, NETWORK: policy, SUPERVISED: Supervisor(policy, own, TOLERANCES)}[driver]
    x, u, cost = scenario.states[0].copy(), scenario.inputs[0].copy(), 0.0
    inputs, exact, states = [], [], [x.copy()]
    for k, disturbance in enumerate(scenario.disturbances):
        x = x + scenario.pushes[k]
        reported = disturbance + scenario.disturbance_errors[k]
        asked = (x + scenario.state_errors[k], reported, u, scenario.references[k : k + problem.horizon])
        answer = judge.control(*asked)
        judge.prepare(problem.period)
        given = answer if drives is judge else drives.control(*asked)
        if drives is not judge:
            drives.prepare(problem.period)
        cost += problem.rate_weights[0] * (given.input[0] - u[0]) ** 2
        u = given.input.copy()
        for _ in range(problem.substeps):
            x = one_step(scenario.plant, x, u + disturbance, step=problem.period / problem.substeps)
        cost += problem.output_weights[0] * ((x[0] - scenario.references[k, 0]) / problem.output_scales[0]) ** 2
        inputs.append(u)
        exact.append(answer.input)
        states.append(x.copy())
    return np.array(inputs), np.array(exact), np.array(states), cost, getattr(drives, "reasons", {})


@pytest.mark.parametrize("driver", [EXACT, NETWORK, SUPERVISED])
def test_a_loop_is_that_of_ordinary_objects(broken, rig, driver):
    """On a plant that is not the model: the beam with its friction, under the MPC of a linear one."""
    criteria = dataclasses.replace(CRITERIA, input_error=(1e9,))
    trial = dataclasses.replace(trial_of(broken, plant=rig.system), criteria=criteria)
    for loop in range(6):
        scenario = trial.scenario(loop)
        driven = trial.run(scenario, driver)
        inputs, exact, states, cost, counted = by_hand(trial, scenario, driver)
        np.testing.assert_allclose(driven.inputs, inputs, atol=1e-9)
        np.testing.assert_allclose(driven.exact, exact, atol=1e-9)
        np.testing.assert_allclose(driven.states, states, atol=1e-11)
        assert driven.measures[COST] == pytest.approx(cost, rel=1e-9)
        assert driven.measures[ERROR] == pytest.approx(np.max(np.abs(inputs - exact)) / 1e9, abs=1e-18)
        assert driven.measures[EXCESS] == 0.0
        reasons = driven.reasons if driver == SUPERVISED else np.zeros(0, dtype=int)
        found = np.bincount(reasons, minlength=len(REASONS))
        assert {REASONS[k]: n for k, n in enumerate(found) if n} == counted


@pytest.mark.parametrize("rig", ["beam", "wheel_motor"])
def test_a_loop_is_the_same_after_others_whose_solutions_it_shares(broken, rig):
    trial = trial_of(broken) if rig == "beam" else trial_of_shipped(rig)
    drivers, scenario = Drivers(trial), trial.scenario(3)
    for driver in DRIVERS:
        shared, alone = drivers.run(scenario, driver), trial.run(scenario, driver)
        np.testing.assert_allclose(shared.inputs, alone.inputs, atol=1e-4)
        np.testing.assert_array_equal(shared.reasons, alone.reasons)


def test_a_network_that_gives_no_numbers_keeps_its_bounds_and_no_loop(law):
    weights = [tuple(np.full_like(part, np.nan) for part in layer) for layer in law.layers]
    found = certify(trial_of(dataclasses.replace(law, layers=tuple(weights))), loops=40, workers=1)
    assert found.failed["network"][MIXTURE]["bounds"] == 0
    assert found.failed["network"][MIXTURE]["cost"] > 20
    assert found.failed["supervised"][MIXTURE]["all"] == 0  # the exact MPC drives
    assert found.ledger[0].check["accepted"] == 0
    assert found.ledger[0].check["out of range"] == 40 * 14


def test_the_exact_mpc_is_asked_again_from_the_network_s_plan_where_they_differ(law):
    """Where it finds nothing cheaper there, the difference stands."""
    shifted = dataclasses.replace(law, layers=(law.layers[0], (law.layers[1][0], law.layers[1][1] + 0.01)))  # 1 V
    found = certify(trial_of(shifted), loops=20, workers=1)
    assert found.failed["network"][MIXTURE]["input"] == 20
    assert found.worst[0]["input_error"] * CRITERIA.input_error[0] == pytest.approx(1.0, abs=0.02)


# The mixture


def test_every_stratum_has_its_part_of_the_loops_and_keeps_to_its_kind(rig):
    """A loop of a kind begins on its reference, one of the stratum apart anywhere."""
    spread = dataclasses.replace(MIXTURE_OF_BEAM.spread, push=(0.0, 0.0))
    plain = dataclasses.replace(MIXTURE_OF_BEAM, spread=spread)
    trial = dataclasses.replace(trial_of(exact_policy(BEAM)), mixture=plain)
    found = {name: [trial.scenario(k) for k in range(400) if stratum_of(k) == name] for name in STRATA}
    assert {len(scenarios) for scenarios in found.values()} == {50}
    largest = 2.0 * VOLT * (1.0 + 1e-9)
    for name, scenarios in found.items():
        on = [abs(each.states[0, 0] - each.references[0, 0]) < 1e-9 for each in scenarios]
        assert np.mean(on) == (0.0 if name == APART else 1.0)
        assert max(np.max(np.abs(each.references)) for each in scenarios) <= largest
    levels = [np.unique(each.references) for each in found["square waves"]]
    assert all(len(each) <= 2 and np.ptp(np.abs(each)) < 1e-12 for each in levels)
    assert all(np.ptp(each.references) == 0.0 for each in found["rests"])
    jumps = {
        name: np.mean([np.mean(np.diff(each.disturbances[:, 0]) != 0.0) for each in scenarios])
        for name, scenarios in found.items()
    }
    assert jumps.pop(DISTURBED) > 3.0 * max(jumps.values())


def test_what_the_rig_declares_moves_its_states():
    """A hand on the brake, which is a state that nothing else moves."""
    trial = trial_of_shipped("drill_string")
    index = [item.name for item in trial.plant.states].index("brake")
    for loop in (7, 15, 23):
        scenario = trial.scenario(loop)
        assert stratum_of(loop) == DISTURBED
        assert np.any(scenario.pushes[:, index])


# The criteria


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


# The file


@pytest.fixture
def certified(law, tmp_path):
    policy = checked(law)
    folder = tmp_path / "policy"
    policy.save(folder)
    seal = storage.digest(folder, kind="policy")
    found = certify(dataclasses.replace(trial_of(policy), seal=seal), loops=40, workers=1)
    found.save(folder)
    return folder, seal, found


def test_a_certificate_survives_a_round_trip(certified):
    folder, seal, found = certified
    back = certificates.find_certificate(folder, policy=seal, model="5ea1")
    assert back is not None
    assert (back.failed, back.loops, back.delta) == (found.failed, 40, DELTA)
    assert back.bounds == found.bounds


def test_a_policy_is_loaded_with_its_certificate_or_without_one(certified):
    folder, _, found = certified
    loaded = policies.load(folder).certificate
    assert loaded is not None
    assert loaded.failed == found.failed
    assert policies.load(folder, certified=False).certificate is None
    (folder / FILE).unlink()
    assert policies.load(folder).certificate is None


def test_a_certificate_that_was_altered_or_is_another_s_is_refused(certified):
    folder, seal, _ = certified
    with pytest.raises(UserError, match="another policy"):
        certificates.find_certificate(folder, policy="another", model="5ea1")
    with pytest.raises(UserError, match="another model"):
        certificates.find_certificate(folder, policy=seal, model="another")
    path = folder / FILE
    path.write_text(path.read_text().replace("seed: 0", "seed: 1"))
    with pytest.raises(UserError, match=r"certificate\.yaml: was altered"):
        policies.load(folder)
    path.write_text("loops: [")
    with pytest.raises(UserError, match="YAML"):
        certificates.find_certificate(folder, policy=seal, model="5ea1")


def test_a_certificate_whose_bounds_are_not_those_of_its_counts_is_refused_by_name(certified):
    """Sealed again by who altered it."""
    folder, seal, found = certified
    content = storage.load_sheet(folder / FILE, kind="certificate", version=FORMAT)
    kept = {key: value for key, value in content.items() if key not in ("format", "seal")}
    kept["bounds"]["supervised"][MIXTURE] = 0.9999
    storage.save_sheet(folder / FILE, version=FORMAT, content=kept)
    counted = f"{found.bounds['supervised'][MIXTURE]:.6f}"
    with pytest.raises(UserError, match=rf"bound of supervised, mixture is 0\.9999, and by its counts it is {counted}"):
        certificates.find_certificate(folder, policy=seal, model="5ea1")


def test_every_seed_that_was_tried_counts(broken):
    """A second seed that does better does not take the place of the first."""
    one = certify(trial_of(broken), loops=30, workers=1)
    two = certify(trial_of(broken, seed=1), loops=50, before=one, workers=1)
    alone = certify(trial_of(broken, seed=1), loops=50, workers=1)
    assert [entry.seed for entry in two.ledger] == [0, 1]
    assert two.loops == 80
    for driver in ("network", "supervised"):
        failed = [each.failed[driver][MIXTURE]["all"] for each in (one, alone)]
        assert two.failed[driver][MIXTURE]["all"] == sum(failed)
        assert two.bounds[driver][MIXTURE] == binomial_bound(80 - sum(failed), 80, DELTA / two.statements)
    other = dataclasses.replace(trial_of(broken, seed=2), criteria=dataclasses.replace(CRITERIA, cost_share=1.0))
    with pytest.raises(UserError, match="another criteria"):
        certify(other, loops=10, before=one, workers=1)


def test_more_loops_of_a_seed_go_on_from_those_that_are_counted(broken):
    """Each is counted once, and the same command again counts nothing."""
    few = certify(trial_of(broken), loops=37, workers=1)
    more, whole = (certify(trial_of(broken), loops=90, before=before, workers=1) for before in (few, None))
    for name in ("strata", "failed", "bounds", "worst"):
        assert getattr(more, name) == getattr(whole, name)
    assert (more.ledger[0].check, more.ledger[0].exact) == (whole.ledger[0].check, whole.ledger[0].exact)
    assert certify(trial_of(broken), loops=90, before=more, workers=1) == more


def test_a_policy_that_changed_meanwhile_is_not_certified(certified, law):
    folder, _, found = certified
    checked(law, seed=1).save(folder)
    assert not (folder / FILE).exists()  # a new policy has none
    with pytest.raises(UserError, match="another policy"):
        found.save(folder)


def test_a_certificate_of_another_policy_is_refused_when_that_is_loaded(certified, law, tmp_path):
    folder, _, _ = certified
    checked(law, seed=1).save(tmp_path / "other")
    (tmp_path / "other" / FILE).write_bytes((folder / FILE).read_bytes())
    with pytest.raises(UserError, match="another policy") as refusal:
        policies.load(tmp_path / "other")
    assert "\n" not in str(refusal.value)


# What can't be certified


def test_a_policy_of_first_inputs_and_strange_numbers_are_refused(law):
    first = dataclasses.replace(law, layers=(law.layers[0], tuple(part[:1] for part in law.layers[1])))
    with pytest.raises(UserError, match="1 of 8 intervals"):
        certify(trial_of(first), loops=10)
    for loops, delta in ((0, 0.01), (10, 0.0), (10, 1.0), (10, math.nan)):
        with pytest.raises(UserError, match="say nothing"):
            certify(trial_of(law), loops=loops, delta=delta)


def test_a_plant_of_other_states_is_refused(law, flexible_joint):
    with pytest.raises(UserError, match="the plant's states"):
        trial_of(law, plant=flexible_joint)
