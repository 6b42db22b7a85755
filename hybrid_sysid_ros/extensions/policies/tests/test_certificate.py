"""The certificate: a law that is exact passes, a broken share is found as that share, and a seed decides all."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import binom

from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.safety import certificate as certificates
from hybrid_sysid_ros.control.safety.certificate import DELTA, FILE, FORMAT, LOOPS, MIXTURE, binomial_bound
from hybrid_sysid_ros.extensions.policies.counting import certify
from hybrid_sysid_ros.extensions.policies.criteria import (
    NETWORK,
)
from hybrid_sysid_ros.extensions.policies.tests.trials import CRITERIA, trial_of
from hybrid_sysid_ros.models import storage
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_policies import BEAM, CARTS, broken_policy, checked, exact_policy

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
        if done >= 256:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(trial, loops=300, workers=1, store=store, progress=interrupt)
    assert len(list(store.iterdir())) == 2
    found = certify(trial, loops=300, workers=1, store=store)
    assert not store.exists()
    whole = certify(trial, loops=300, workers=1)
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
