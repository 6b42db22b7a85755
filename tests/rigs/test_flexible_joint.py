"""The flexible joint: its physics, what its hybrids see, and what ships for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.core import one_step, simulate, step_with_jacobian
from hybrid_sysid_ros.extensions.shared.steady_motion import steady_motion
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.models.structure import build, structure_of
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration

STEP = 1e-4
MOTOR, LINK, MOTOR_SPEED, LINK_SPEED, DEFLECTION = range(5)


@pytest.fixture(scope="module")
def rig():
    return rigs.load("flexible_joint")


@pytest.fixture(scope="module")
def model():
    return load_model(configuration.shipped("flexible_joint", "model"))


def run(system: Any, torque: float, seconds: float, start: Any = None) -> Any:
    """States at every step under a constant torque."""
    started = np.zeros(len(system.states)) if start is None else start
    return simulate(system, started, np.full((round(seconds / STEP), 1), torque), step=STEP)


def test_what_the_motor_turns_the_link_gets(rig):
    """J d'' + I q'' = tau without friction, whatever the elastomer does."""
    system = replace(rig.system, coulomb=0.0, static_excess=0.0, viscous_friction=0.0, bristle_damping=0.0)
    states = run(system, 0.7, 0.5)
    momentum = system.motor_inertia * states[:, MOTOR_SPEED] + system.link_inertia * states[:, LINK_SPEED]
    np.testing.assert_allclose(momentum, 0.7 * STEP * np.arange(len(states)), rtol=1e-9, atol=1e-12)


def test_lugre_s_friction_at_a_steady_speed_is_stribeck_s_curve(rig):
    """tau = fc + (fs - fc) exp(-(v / vs)^2) + fv v where nothing changes any more."""
    system, torque = rig.system, 0.4
    speed = run(system, torque, 20.0)[-1, MOTOR_SPEED]
    excess = system.static_excess * np.exp(-((speed / system.stribeck_speed) ** 2))
    assert torque == pytest.approx(system.coulomb + excess + system.viscous_friction * speed, rel=1e-4)


def test_dahl_s_friction_while_it_slides_is_coulomb_s(rig):
    """(J + I) times the acceleration, averaged over the ringing, is tau - fc."""
    system, seconds = rig.structures["dahl"], 4.0
    states = run(system, 1.0, seconds)
    inertia = system.motor_inertia + system.link_inertia
    speed = (system.motor_inertia * states[:, MOTOR_SPEED] + system.link_inertia * states[:, LINK_SPEED]) / inertia
    late = round(2.0 / STEP)
    assert (speed[-1] - speed[late]) / (seconds - 2.0) * inertia == pytest.approx(1.0 - system.coulomb, rel=1e-3)


def test_below_the_static_friction_bristles_bend_and_the_motor_stays(rig):
    """tau = s0 z at rest."""
    system, torque = rig.system, 0.2
    state = run(system, torque, 25.0)[-1]
    assert state[DEFLECTION] == pytest.approx(torque / system.bristle_stiffness, rel=1e-3)
    assert abs(state[MOTOR_SPEED]) < 1e-4


def test_the_elastomer_stiffens_as_it_says(rig):
    """t = Ke w + k3 w^3 + ce w'."""
    system = rig.system
    assert system.elastomer(0.1, 0.0) == pytest.approx(0.1 * system.spring + 0.001 * system.stiffening)
    assert system.elastomer(0.0, 2.0) == pytest.approx(2.0 * system.elastomer_damping)


def test_the_record_of_a_twisted_joint_shows_the_link_s_angle(rig):
    """I q'' = Ke (d - q): the acceleration of the link tells the twist."""
    system = rig.structures["linear"]
    twist, angle = 0.03, 5.0
    acceleration = system.spring * twist / system.link_inertia
    states = system.record_map().states_from_record(
        np.array([[angle, 1.0]]), np.array([[0.0, acceleration]]), np.zeros((1, 1))
    )
    np.testing.assert_allclose(states[0, [MOTOR, LINK, LINK_SPEED]], [angle, angle - twist, 1.0])


@pytest.mark.parametrize("structure", ["gray", "hybrid_linear", "hybrid_lugre"])
def test_no_model_of_it_knows_how_often_it_has_turned(rig, structure):
    """Moved by both angles alike, everything moves alike."""
    system, _ = build(
        structure, rig.system, scales=np.ones(5), features=np.ones(4), seed=0, boxes=rig.structures,
        options={"everywhere": 1} if structure.startswith("hybrid") else {},
    )  # fmt: skip
    random = np.random.default_rng(1)
    turned = np.zeros(len(system.states))
    turned[[MOTOR, LINK]] = 40.0 * np.pi
    for _ in range(20):
        x, u = random.normal(size=len(system.states)), random.normal(size=1)
        moved = one_step(system, x + turned, u, step=0.005) - one_step(system, x, u, step=0.005)
        np.testing.assert_allclose(moved, turned, atol=1e-9)


def test_its_gray_boxes_are_its_own(rig):
    for name, system in rig.structures.items():
        assert structure_of(name, rig.system, rig.structures).box == name
        built, _ = build(name, rig.system, scales=np.ones(5), seed=0, boxes=rig.structures)
        assert type(built) is type(system)


def test_what_ships_belongs_together(rig, model):
    """Model, policy and certificate of one another, and of this rig's problem."""
    shipped = policy.load(configuration.shipped("flexible_joint", "policy"), model=model)
    values = configuration.defaults("flexible_joint", "controller")
    assert model.rig == shipped.rig == "flexible_joint"
    assert shipped.problem == configuration.mpc_problem(values, rig, model.system)
    assert shipped.certificate is not None
    assert min(shipped.certificate.rates["supervised"]["mixture"][kept] for kept in ("bounds", "cost")) >= 0.99


@pytest.mark.parametrize("speed", [3e-4, 0.004, -0.03, 1.0])
def test_bristles_of_a_slow_motion_deflect_as_far_as_they_bear(model, speed):
    """z = g(v) / s0, from which closed loops begin: rounded over .05 rad/s it would be .13 rad at .004 rad/s, and the
    friction 4.6 N m.
    """
    values = configuration.defaults("flexible_joint", "controller")
    problem = configuration.mpc_problem(values, rigs.load("flexible_joint"), model.system).sized(model.system)
    motion = steady_motion(model.system, problem, np.array([0.0, speed]))
    named = model.system.named
    level = named["coulomb"] + named["static_excess"] * np.exp(-((speed / named["stribeck_speed"]) ** 2))
    assert motion.state[DEFLECTION] == pytest.approx(np.sign(speed) * level / named["bristle_stiffness"], rel=0.01)
    np.testing.assert_allclose(motion.state[[MOTOR_SPEED, LINK_SPEED]], speed, rtol=1e-6)


def test_an_mpc_answers_where_its_quadratic_programs_go_round_in_circles(model):
    """Bristles that are bent six times beyond what they bear, as an estimator that is far off may have them: the
    prediction runs away, and the Hessian is 1e12.
    """
    values = configuration.defaults("flexible_joint", "controller")
    problem = configuration.mpc_problem(values, rigs.load("flexible_joint"), model.system).sized(model.system)
    state = np.array(
        [-0.017635718200665403, -0.02215158404421145, 0.21172714015154265, 0.015337249730392483, -0.06983414273781507]
    )
    preview = np.tile([0.0, -0.007731899781775464], (problem.horizon, 1))
    mpc = ExactMpc(model.system, problem, tolerance=1e-3)
    plan = mpc.control(state, np.array([-0.08693327537369319]), np.array([-0.920835903394273]), preview)
    assert plan.status in (Status.SOLVED, Status.NOT_CONVERGED)
    assert np.all(np.abs(plan.inputs) <= 2.0)


def test_the_shipped_policy_answers_alike_after_many_turns(model):
    shipped = policy.load(configuration.shipped("flexible_joint", "policy"), model=model)
    random = np.random.default_rng(3)
    turned = np.array([40.0 * np.pi, 40.0 * np.pi, 0.0, 0.0, 0.0])
    for _ in range(20):
        x = 0.01 * random.normal(size=5)
        preview = np.column_stack([np.zeros(shipped.horizon), np.full(shipped.horizon, random.normal())])
        given = np.zeros(1), np.zeros(1), preview
        np.testing.assert_allclose(
            shipped.control(x, *given).inputs, shipped.control(x + turned, *given).inputs, atol=1e-6
        )
        assert shipped.inside(x, *given) == shipped.inside(x + turned, *given)


def test_the_flexible_joint_rings_at_the_frequency_of_its_spring():
    """Free-free, w^2 = Ke (1/J + 1/I): a small twist of the rig without friction or damping."""
    structures = rigs.load("flexible_joint").structures
    named = structures["linear"].named
    kind: Any = type(structures["linear"])
    joint = kind(viscous_friction=0.0)
    expected = np.sqrt(named["spring"] * (1 / named["motor_inertia"] + 1 / named["link_inertia"])) / (2 * np.pi)
    states = simulate(joint, np.array([0.01, 0.0, 0.0, 0.0]), np.zeros((20_000, 1)), step=1e-4)
    twist = states[:, 0] - states[:, 1]
    crossings = np.flatnonzero((twist[:-1] < 0) & (twist[1:] >= 0)) * 1e-4
    assert 1 / np.mean(np.diff(crossings)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("structure", ["dahl", "lugre"])
def test_bristles_at_rest_give_way_to_a_small_torque(structure):
    """The slope of the motor's speed by the torque is that of a small step, not zero: optimisers begin there."""
    system = rigs.load("flexible_joint").structures[structure]
    n, small = len(system.states), 1e-6
    _, jacobian = step_with_jacobian(system, np.zeros(n), np.zeros(1), step=1e-3, smoothing=0.01)
    moved = one_step(system, np.zeros(n), np.array([small]), step=1e-3) / small
    np.testing.assert_allclose(jacobian[:, n], moved, rtol=1e-4)
    assert moved[2] > 0.0
