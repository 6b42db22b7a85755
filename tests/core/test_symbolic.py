"""The CasADi export: the compiled form, in anyone's own script."""

import casadi
import numpy as np
import pytest

from hybrid_sysid_ros.core import one_step, simulate, step_with_jacobian
from hybrid_sysid_ros.core.symbolic import symbolic_output, symbolic_step
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from tests.evaluation import parametric_step
from tests.structures import DEFLECTION, FURTHER, MOTIONS, RANGE, SYSTEMS, ThrusterCart, TwoTanks, structure


def points(count=200, seed=1):
    random = np.random.default_rng(seed)
    for _ in range(count):
        # Half of the points are slow: there dry friction decides.
        slow = random.choice([1e-3, 1.0])
        yield random.uniform(-1.5, 1.5, 3) * RANGE * np.array([1.0, slow, 1.0])


@pytest.mark.parametrize("name", MOTIONS)
def test_the_compiled_and_the_casadi_form_agree(name):
    system = structure(name)
    symbolic = symbolic_step(system, step=0.005)
    random = np.random.default_rng(2)
    for x in points():
        hidden = DEFLECTION * random.uniform(-1, 1, len(system.states) - 2)
        state = np.concatenate([x[:2], hidden])
        expected = np.array(symbolic(state, x[2:])).ravel()
        np.testing.assert_allclose(one_step(system, state, x[2:], step=0.005), expected, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("name", ["stribeck", "gray"])
def test_the_smooth_form_is_off_by_half_its_smoothing_at_most(name):
    # (sqrt((x + L)^2 + s^2) - sqrt((x - L)^2 + s^2)) / 2 lies within s / 2 of x held within +-L.
    system = structure(name)
    largest = []
    for smoothing in (1e-2, 1e-4, 1e-6):
        symbolic = symbolic_step(system, step=0.005, smoothing=smoothing)
        errors = [
            abs(one_step(system, x[:2], x[2:], step=0.005)[1] - float(symbolic(x[:2], x[2:])[1])) for x in points()
        ]
        # A law may round corners of its own by a fixed width, which is far below what counts.
        own = 0.0 if name == "stribeck" else 2e-4
        assert max(errors) <= smoothing / 2 * (1 + 1e-6) + own
        largest.append(max(errors))
    assert largest[0] > 1e-4  # or the points would never have met a corner


def test_substeps_are_steps_in_turn():
    system = structure("gray")
    x, u = np.array([0.02, -0.1]), np.array([3.0])
    expected = x
    for _ in range(4):
        expected = one_step(system, expected, u, step=0.005)
    symbolic = symbolic_step(system, step=0.005, substeps=4)
    np.testing.assert_allclose(np.array(symbolic(x, u)).ravel(), expected, rtol=1e-12)


def test_two_joints_agree_in_both_forms(flexible_joint, motor):
    random = np.random.default_rng(0)
    for system in (flexible_joint, motor):
        symbolic = symbolic_step(system, step=0.002)
        for _ in range(100):
            x, u = random.normal(size=len(system.states)), random.normal(size=1)
            expected = np.array(symbolic(x, u)).ravel()
            np.testing.assert_allclose(one_step(system, x, u, step=0.002), expected, rtol=1e-12, atol=1e-14)


CORNERLESS = ("dahl", "lugre", *(name for name in FURTHER if name != "residual"))
"""Their step is the same whatever corners of dry friction are rounded over."""


@pytest.mark.parametrize(
    ("name", "smoothing"),
    [(name, smoothing) for name in SYSTEMS for smoothing in ((0.0,) if name in CORNERLESS else (0.0, 0.005))],
)
def test_the_slopes_of_a_step_are_those_of_the_casadi_form(name, smoothing):
    system = SYSTEMS[name]()
    states, inputs = len(system.states), len(system.inputs)
    x, u, p, following = parametric_step(system, step=0.005, smoothing=smoothing)
    free = [i for i, item in enumerate(system.parameters) if not item.fixed]
    by = casadi.vertcat(x, u, p[free]) if free else casadi.vertcat(x, u)
    expected = casadi.Function("j", [x, u, p], [following, casadi.jacobian(following, by)])
    random = np.random.default_rng(3)
    for _ in range(20):
        state = random.uniform(-1, 1, states) * np.append(RANGE[:2], np.full(states - 2, DEFLECTION))
        drive = random.uniform(-1, 1, inputs) * RANGE[2]
        out, jacobian = step_with_jacobian(system, state, drive, step=0.005, smoothing=smoothing, learn=True)
        value, jacobian = expected(state, drive, system.values)
        np.testing.assert_allclose(out, np.array(value).ravel(), rtol=1e-9, atol=1e-12)
        found = jacobian[:, : states + inputs + len(free)]
        np.testing.assert_allclose(found, np.array(jacobian), rtol=1e-8, atol=1e-10)


def test_what_rounding_does_to_bristles_goes_with_it():
    system = structure("lugre")
    state, drive = np.array([0.01, 0.2, 1e-4]), np.array([3.0])
    exact, *rounded = (
        step_with_jacobian(system, state, drive, step=0.005, smoothing=s)[1] for s in (0.0, 1e-2, 1e-3, 1e-4)
    )
    errors = [np.abs(jacobian - exact).max() for jacobian in rounded]
    assert errors[0] > 10.0 * errors[1] > 100.0 * errors[2]


@pytest.mark.parametrize("system", [TwoTanks(), ThrusterCart()], ids=["tanks", "cart"])
def test_the_output_map_and_its_slopes_are_the_exported_ones(system):
    output = symbolic_output(system)
    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u", 2)
    expected = casadi.Function("j", [x, u], [casadi.jacobian(output(x, u), casadi.vertcat(x, u))])
    state, drive = np.array([0.3, -0.2]), np.array([1.0, 2.0])
    out, jacobian = step_with_jacobian(system, state, drive, step=0.01, output=True)
    np.testing.assert_allclose(out, np.array(output(state, drive)).ravel(), rtol=1e-13)
    np.testing.assert_allclose(jacobian, np.array(expected(state, drive)), rtol=1e-13)


EXPORTED = {
    "gray": CamBeam(input_delay=0.0),
    "hybrid": structure("hybrid"),
    "lugre": structure("lugre"),
    "two inputs": TwoTanks(left_delay=0.0, right_delay=0.0),
}


def driven(system, steps=200):
    """Inputs and a run under them, without delay: who exports a step delays the inputs himself."""
    if "input_delay" in system.named:
        system = system.with_values(list({**system.named, "input_delay": 0.0}.values()))
    random = np.random.default_rng(4)
    inputs = random.uniform(-1, 1, (steps // 10, len(system.inputs))).repeat(10, axis=0) * RANGE[2]
    return system, inputs, simulate(system, np.zeros(len(system.states)), inputs, step=0.005)


@pytest.mark.parametrize("name", EXPORTED)
def test_an_exported_step_simulates_as_the_compiled_one(name):
    system, inputs, expected = driven(EXPORTED[name])
    step, state = symbolic_step(system, step=0.005), np.zeros(len(system.states))
    for drive, following in zip(inputs, expected[1:], strict=True):
        state = np.array(step(state, drive)).ravel()
        np.testing.assert_allclose(state, following, rtol=1e-9, atol=1e-12)


@pytest.mark.filterwarnings("ignore")  # of do-mpc, about features that are not installed
@pytest.mark.parametrize("name", EXPORTED)
def test_do_mpc_simulates_an_exported_step_as_the_compiled_one(name):
    do_mpc = pytest.importorskip("do_mpc", exc_type=ImportError)
    system, inputs, expected = driven(EXPORTED[name])
    step = symbolic_step(system, step=0.005)
    model = do_mpc.model.Model("discrete", "SX")
    x = casadi.vertcat(*(model.set_variable("_x", item.name) for item in system.states))
    u = casadi.vertcat(*(model.set_variable("_u", item.name) for item in system.inputs))
    for item, row in zip(system.states, casadi.vertsplit(step(x, u)), strict=True):
        model.set_rhs(item.name, row)
    model.setup()
    simulator = do_mpc.simulator.Simulator(model)
    simulator.set_param(t_step=0.005)
    simulator.setup()
    simulator.x0 = np.zeros(len(system.states))
    for drive, following in zip(inputs, expected[1:], strict=True):
        simulator.make_step(drive[:, None])
        np.testing.assert_allclose(np.array(simulator.x0.cat).ravel(), following, rtol=1e-9, atol=1e-12)
