"""A trial: its loops are those of ordinary objects, and its mixture has a part of every kind."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.safety.certificate import MIXTURE
from hybrid_sysid_ros.control.safety.supervisor import REASONS, Supervisor
from hybrid_sysid_ros.core import one_step
from hybrid_sysid_ros.extensions.policies.counting import certify
from hybrid_sysid_ros.extensions.policies.criteria import (
    COST,
    DRIVERS,
    ERROR,
    EXACT,
    EXCESS,
    NETWORK,
    SUPERVISED,
)
from hybrid_sysid_ros.extensions.policies.mixture import APART, DISTURBED, STRATA, stratum_of
from hybrid_sysid_ros.extensions.policies.tests.trials import (
    CRITERIA,
    MIXTURE_OF_BEAM,
    TOLERANCES,
    VOLT,
    trial_of,
    trial_of_shipped,
)
from hybrid_sysid_ros.extensions.policies.trial import KKT_TOLERANCE, Drivers
from tests.linear_policies import BEAM, exact_policy

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
        driven = Drivers(trial).run(scenario, driver)
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
        shared, alone = drivers.run(scenario, driver), Drivers(trial).run(scenario, driver)
        np.testing.assert_allclose(shared.inputs, alone.inputs, atol=1e-4)
        np.testing.assert_allclose(shared.exact, alone.exact, atol=1e-4 * np.abs(alone.exact).max())
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
