"""TrainingSamples of the exact MPC: closed loops of it, on scenarios that are drawn."""

import dataclasses

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.extensions.policies.network_loop import run_network
from hybrid_sysid_ros.extensions.policies.samples import TrainingSamples, sample, scenario_of, shifted
from hybrid_sysid_ros.extensions.shared import drawn_scenarios, scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import LENGTH, Spread, plant_near
from hybrid_sysid_ros.extensions.shared.steady_motion import steady_motion
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_policies import CARTS, CASES, exact_policy
from tests.small_policies import PROBLEM, SPREAD, model_of

CARTS_SPREAD = Spread(
    amplitude=(0.5, 0.0, 0.3),
    disturbance=(0.2, 0.1),
    input_jitter=(0.5, 0.3),
    push=(0.05, 0.05, 0.2, 0.2),
    centre=(0.2,),
)
SPREADS = {"beam": SPREAD, "carts": CARTS_SPREAD}


@pytest.fixture(params=CASES)
def drawn(request):
    """A linear case and the samples of one of its loops, a few in number."""
    case = CASES[request.param]
    return case, sample(case.system, case.problem, SPREADS[request.param], 7)


def test_samples_are_answers_of_the_exact_mpc(drawn):
    """By the normal equations, where no bound is near."""
    case, samples = drawn
    periods = LENGTH * case.problem.horizon
    assert len(samples.plans) + samples.dropped == periods
    assert samples.dropped < 0.1 * periods
    size = case.problem.input_high[0]
    free = np.flatnonzero(np.all(np.abs(samples.plans) < 0.35 * size, axis=(1, 2)))
    assert len(free) > 10
    for k in free[::5]:
        np.testing.assert_allclose(samples.plans[k], case.plan(samples.instances[k]), atol=2e-3)


def test_what_a_solver_does_not_solve_gives_no_samples(rig):
    hopeless = dataclasses.replace(PROBLEM, max_iterations=1)
    samples = sample(rig.system, hopeless, SPREAD, 7)
    assert len(samples.plans) + samples.dropped == LENGTH * PROBLEM.horizon
    assert samples.dropped > 0.6 * LENGTH * PROBLEM.horizon


def test_a_loop_that_a_network_drives_in_compiled_code_is_that_of_its_own_calls():
    """To the last digit, and where it has no answer, too."""
    case, spread = CARTS, CARTS_SPREAD.sized(CARTS.system)
    scenario = scenario_of(case.system, case.problem, spread, np.random.default_rng(3))
    silent = scenario._replace(state_errors=scenario.state_errors.copy())
    silent.state_errors[7] = np.nan
    policy = exact_policy(case)
    for each in (scenario, silent):
        found = run_network(each, case.problem, policy)
        by_hand = scenarios.run(each, case.problem, lambda _, asked: policy.control(*asked).input)
        for one, other in zip(found, by_hand, strict=True):
            np.testing.assert_array_equal(one, other)


def test_plants_are_drawn_about_the_model_within_bounds():
    system, random = model_of().system, np.random.default_rng(0)
    values = np.array([plant_near(system, 0.1, random).values for _ in range(2000)])
    for item, nominal, column in zip(system.parameters, system.values, values.T, strict=True):
        assert np.all((column >= item.low) & (column <= item.high))
        assert np.std(column) == pytest.approx(0.1 * abs(nominal), rel=0.1)
        assert np.mean(column) == pytest.approx(nominal, abs=0.01 * abs(nominal))
    np.testing.assert_array_equal(plant_near(system, 0.0, random).values, system.values)


def test_scenarios_are_of_what_the_spread_says():
    case, spread = CARTS, CARTS_SPREAD.sized(CARTS.system)
    random = np.random.default_rng(0)
    found = [scenario_of(case.system, case.problem, spread, random) for _ in range(200)]
    wanted = np.concatenate([scenario.references for scenario in found])
    assert np.all(np.abs(wanted - 0.2) <= np.array(spread.amplitude) * (1 + 1e-9))
    assert np.all(np.max(np.abs(wanted - 0.2), axis=0) >= 0.95 * np.array(spread.amplitude))
    disturbances = np.concatenate([scenario.disturbances for scenario in found])
    np.testing.assert_allclose(disturbances.std(axis=0), spread.disturbance, rtol=0.1)
    assert np.mean(np.any(np.diff(disturbances, axis=0) != 0.0, axis=1)) < 0.1  # it jumps now and then
    inputs = np.concatenate([scenario.inputs for scenario in found])
    np.testing.assert_allclose(inputs.min(axis=0), case.problem.input_low, atol=1.0)
    np.testing.assert_allclose(inputs.max(axis=0), case.problem.input_high, atol=1.0)


def test_loops_begin_on_the_reference_or_anywhere_and_at_rest_there():
    """Without pushes the states are steady: the system stays where it is under inputs that hold it."""
    case = CARTS
    spread = dataclasses.replace(CARTS_SPREAD, push=(0.0,)).sized(case.system)
    wanted = 0.2 + np.random.default_rng(1).uniform(-0.3, 0.3, (400, 3))
    begins = np.arange(400) < 300
    states = drawn_scenarios.beginnings(np.random.default_rng(0), case.system, case.problem, spread, wanted, begins)
    assert not states[300:].any()
    states, wanted = states[:300], wanted[:300]
    np.testing.assert_allclose(states[:, 2:], 0.0, atol=1e-9)
    on = np.all(np.abs(states @ case.c[case.tracked].T - wanted[:, case.tracked]) < 1e-9, axis=1)
    assert 0.4 < np.mean(on) < 0.6


def test_a_loop_of_a_rig_with_dry_friction_begins_as_it_turns():
    """A bit that turns twists its shaft by friction and drag at that speed, k d + Tf + cd w = 0. The slope at rest of
    friction that is rounded there would give a hundred times the twist.
    """
    rig = rigs.load("drill_string")
    system, named = rig.system, rig.system.named
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig)
    spread = Spread(amplitude=(8.0, 0.0), disturbance=(0.0,), push=(0.0,)).sized(system)
    wanted = np.column_stack([np.linspace(4.0, 8.0, 50), np.zeros(50)])  # the plan's rounding takes .8 % at 4
    states = drawn_scenarios.beginnings(
        np.random.default_rng(0), system, problem, spread, wanted, np.full(50, True), apart=0.0
    )
    twist, bit, top = states[:, :3].T
    np.testing.assert_allclose(bit, wanted[:, 0], rtol=1e-6)
    np.testing.assert_allclose(top, wanted[:, 0], rtol=1e-6)
    level = named["coulomb"] + named["static_excess"] * np.exp(-((bit / named["stribeck_speed"]) ** 2))
    np.testing.assert_allclose(-named["stiffness"] * twist, level + named["bit_damping"] * bit, rtol=0.01)


def test_a_push_moves_what_the_tracked_outputs_don_t_show():
    """No level flight has a path angle, so a loop that is to begin on its references is not pushed along one: that
    would take an angle of attack of 17 degrees, where the vehicle's equations end at 6.
    """
    rig = rigs.load("winged_cone")
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig).sized(rig.system)
    spread, validity = drawn_scenarios.spread_of(rig, rig.system).sized(rig.system), rig.validity
    assert validity is not None
    wanted = np.zeros((40, 5))
    wanted[:, 0], wanted[:, 2] = np.linspace(-40.0, 40.0, 40), np.linspace(700.0, -700.0, 40)
    states = drawn_scenarios.beginnings(
        np.random.default_rng(0), rig.system, problem, spread, wanted, np.full(40, True), apart=0.0
    )
    np.testing.assert_allclose(states[:, [0, 2]], wanted[:, [0, 2]], atol=1e-6)
    np.testing.assert_allclose(states[:, 1], 0.0, atol=1e-6)
    assert np.all((validity[0] <= states) & (states <= validity[1]))
    assert np.all(np.std(states[:, 3:5], axis=0) > 0.5 * np.array(spread.push)[3:5])


def test_a_steady_motion_is_rest_where_outputs_are_positions_and_drift_where_one_is_a_speed(flexible_joint):
    """A joint that is to turn at a speed turns on: both sides at that speed, its spring as far as drag stretches."""

    class Turning(type(flexible_joint)):  # type: ignore[misc]
        outputs = ("motor", "link_speed")

    system = Turning(coulomb=0.0)
    problem = dataclasses.replace(
        PROBLEM,
        output_weights=(0.0, 1.0),
        output_scales=(1.0, 1.0),
        state_low=(-np.inf,),
        state_high=(np.inf,),
        soft_linear=(0.0,),
        soft_quadratic=(1e4,),
    ).sized(system)
    joint = dataclasses.replace(problem, output_weights=(1.0,), output_scales=(1.0,))
    speed = 3.0
    motion = steady_motion(system, problem, np.array([0.0, speed]))
    stretch = system.link_drag * speed / system.spring
    np.testing.assert_allclose(motion.state[2:], speed, rtol=1e-6)
    assert motion.state[0] - motion.state[1] == pytest.approx(stretch, rel=1e-6)
    at_rest = steady_motion(flexible_joint, joint.sized(flexible_joint), np.array([0.4]))
    np.testing.assert_allclose(at_rest.state, [0.4, 0.4, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("change", [{"amplitude": (1.0, 2.0)}, {"push": (1.0,) * 3}, {"disturbance": (0.1,) * 4}])
def test_a_spread_of_other_sizes_is_refused(change):
    with pytest.raises(UserError, match=next(iter(change))):
        dataclasses.replace(CARTS_SPREAD, **change).sized(CARTS.system)


def test_other_plants_make_other_loops_for_the_same_mpc():
    system = model_of().system
    same, other = (sample(system, PROBLEM, dataclasses.replace(SPREAD, parameters=p), 7) for p in (0.0, 0.2))
    assert np.max(np.abs(same.instances[20] - other.instances[20])) > 1e-4


def test_shifts_are_derivatives_of_the_plan_by_the_followed_parameters():
    """Against differences over a tenth of the step, of plans that are solved afresh."""
    system = model_of().system
    followed = {"gain": 0.5, "centre": 0.2}
    samples = sample(system, PROBLEM, SPREAD, 7, followed=followed)
    assert samples.shifts.shape == (len(samples.plans), 2, 4, 1)
    inside = np.flatnonzero(np.all(np.abs(samples.plans) < 9.0, axis=(1, 2)))[::8]
    assert len(inside) > 5
    for index, (name, spread) in enumerate(followed.items()):
        near = [shifted(system, name, side * spread) for side in (-0.05, 0.05)]
        pair = [ExactMpc(plant, PROBLEM, tolerance=1e-9) for plant in near]
        for k in inside:
            asked = samples.instances[k]
            for mpc in pair:
                mpc.reset()
            low, high = (mpc.control(asked[:2], asked[2:3], asked[3:4], asked[4:, None]).inputs for mpc in pair)
            np.testing.assert_allclose(samples.shifts[k, index], (high - low) / 0.1, rtol=0.05, atol=0.02)


def test_the_offset_of_the_input_shifts_the_first_plan_one_to_one():
    """A beam's centre acts as an offset of its input: plans of low weight on changes move with it."""
    system = model_of().system
    problem = dataclasses.replace(PROBLEM, rate_weights=(0.0,), input_low=(-1e3,), input_high=(1e3,))
    samples = sample(system, problem, SPREAD, 3, followed={"centre": 0.2})
    np.testing.assert_allclose(samples.shifts[:, 0], 0.2, atol=1e-3)


def some_samples(**parts):
    random = np.random.default_rng(0)
    arrays = {
        "instances": random.normal(size=(5, 8)),
        "plans": random.normal(size=(5, 4, 1)),
        "shifts": random.normal(size=(5, 0, 4, 1)),
    }
    return TrainingSamples(**{**arrays, **parts}, dropped=np.array([3]))


def test_samples_come_back_from_their_arrays():
    samples = some_samples()
    both = TrainingSamples.joined([samples.arrays, samples.arrays])
    assert (len(both.plans), both.dropped.sum()) == (10, 6)
    for item in dataclasses.fields(TrainingSamples):
        np.testing.assert_array_equal(np.split(getattr(both, item.name), 2)[1], getattr(samples, item.name))
