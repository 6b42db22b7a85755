"""Systems: what a class declares, what its law may be, and how each mistake is reported in one line."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hybrid_sysid_ros.core import (
    Bristles,
    Dry,
    RungeKutta,
    Softsign,
    System,
    Variable,
    Viscous,
    bounded,
    compiled,
    one_step,
    rollouts,
    simulate,
)
from hybrid_sysid_ros.core.mathematics import sin
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.errors import UserError
from tests.one_joint import Linear
from tests.structures import RANGE, structure


@dataclass(frozen=True, kw_only=True)
class Pendulum(System):
    """q'' = (u - m g l sin q - d q') / J, dry friction on q' [rad/s^2]."""

    states = ("position [rad]", "rate [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("position", "height [m]")
    contacts = (Dry(on="rate", level="friction"),)

    inertia: float = bounded(0.02, 0.001, 1.0, unit="kg m^2")
    """Of arm and motor,
    about the axis."""
    weight: float = bounded(0.8, 0.0, 10.0, unit="N m")
    """m g l."""
    damping: float = bounded(0.01, 0.0, 1.0, unit="N m s/rad")
    """d."""
    coulomb: float = bounded(0.04, 0.0, 1.0, unit="N m")
    """Torque of the dry friction."""

    def law(self, x, u):
        q, v = x
        return v, (u[0] - self.weight * sin(q) - self.damping * v) / self.inertia

    def friction(self, x, u):
        return self.coulomb / self.inertia

    def output(self, x, u):
        return x[0], -0.1 * sin(x[0] + np.pi / 2)


def test_a_class_is_read_when_it_is_made():
    kind: Any = Pendulum  # its variables are read when it is made
    assert kind.states == (Variable(name="position", unit="rad"), Variable(name="rate", unit="rad/s"))
    assert [str(item) for item in Pendulum.outputs] == ["position [rad]", "height [m]"]
    assert Linear.outputs == Linear.states[:1]
    inertia = Pendulum().parameters[0]
    assert (inertia.name, inertia.unit, inertia.description) == (
        "inertia",
        "kg m^2",
        "Of arm and motor, about the axis.",
    )
    assert Pendulum().named == {"inertia": 0.02, "weight": 0.8, "damping": 0.01, "coulomb": 0.04}


def test_a_pendulum_swings_as_its_differential_equation():
    """A turn through the whole circle, at a rate of one sign, where an ordinary solver can integrate the friction."""

    def rates(t, x):
        return [x[1], (0.3 - 0.8 * np.sin(x[0]) - 0.01 * x[1] - 0.04) / 0.02]

    start = np.array([0.0, 16.0])
    exact = solve_ivp(rates, (0.0, 0.5), start, rtol=1e-11, atol=1e-12)
    assert np.all(exact.y[1] > 0)
    assert exact.y[0, -1] > 2 * np.pi
    inputs = np.full((100_000, 1), 0.3)
    states, outputs = rollouts(Pendulum(), np.array([[0, 0, 2, 0]]), start[None], inputs, step=5e-6, every=100_000)
    np.testing.assert_allclose(states[-1], exact.y[:, -1], rtol=1e-4)
    np.testing.assert_allclose(outputs, np.column_stack([states[:, 0], -0.1 * np.cos(states[:, 0])]), rtol=1e-12)


def test_a_pendulum_swings_faster_about_its_rest_than_from_high_up():
    """T = 2 pi sqrt(J / m g l) K(sin(q0 / 2)) 2 / pi, K the complete elliptic integral of the first kind."""
    from scipy.special import ellipk

    free = Pendulum(damping=0.0, coulomb=0.0)
    for angle in (0.05, 2.5):
        x = simulate(free, np.array([angle, 0.0]), np.zeros((200_000, 1)), step=2e-5)[:, 0]
        zeros = np.flatnonzero(np.diff(np.sign(x)) > 0) * 2e-5
        period = 4 * np.sqrt(0.02 / 0.8) * ellipk(np.sin(angle / 2) ** 2)
        np.testing.assert_allclose(np.diff(zeros), period, rtol=1e-4, atol=4e-5)


def test_friction_holds_a_pendulum_up_to_its_own_torque():
    held = np.arcsin(0.04 / 0.8)
    for angle, moves in ((0.98 * held, False), (1.02 * held, True)):
        states = simulate(Pendulum(), np.array([angle, 0.0]), np.zeros((100, 1)), step=1e-3)
        assert (states[-1, 0] != angle) == moves


def test_nothing_grows_outside_the_range_that_was_identified():
    """Beyond its range only the spring, which is straight, still acts on the beam."""
    beam = CamBeam(range_low=-0.1, range_high=0.1, range_speed=2.0, damping=0.0, creep=0.0)
    h = 1e-6

    def at(q, v):
        return (one_step(beam, np.array([q, v]), np.array([2.0]), step=h)[1] - v) / h + beam.stiffness * q

    for edge, far in ((0.1, 5.0), (-0.1, -5.0)):
        for fast in (2.0, -2.0):
            assert at(far, fast) == pytest.approx(at(edge, fast), rel=1e-6)
            assert at(far, 1e3 * fast) == pytest.approx(at(edge, fast), rel=1e-3)
            assert abs(at(edge, fast) - at(edge, 0.1 * fast)) > 1.0  # or speed would not matter at all


@pytest.mark.parametrize("name", ["black_box", "hybrid"])
def test_a_network_is_bounded_however_far_it_is_asked(name):
    system: Any = structure(name)
    silent = system.with_weights(np.zeros(len(system.weights)))
    outputs = len(system.on)
    output_weights = system.weights.reshape(system.block.units, -1)[:, -outputs:]
    bound = np.array(system.scales[-outputs:]) @ np.sum(np.abs(output_weights), axis=0)
    random = np.random.default_rng(1)
    for _ in range(200):
        x = random.uniform(-1.5, 1.5, 3) * RANGE
        for far in (x, 1e3 * x):
            moved = [one_step(item, far[:2], far[2:], step=0.005)[1] for item in (system, silent)]
            assert abs(moved[0] - moved[1]) <= 0.005 * bound * (1 + 1e-9)


def test_fields_that_are_no_parameters_are_part_of_the_form():
    """Two objects of one class whose options differ must not share their compiled code."""

    @dataclass(frozen=True, kw_only=True)
    class Power(System):
        states = ("x [1]",)
        inputs = ("u [1]",)
        stepper = RungeKutta()
        order: int = 1
        table: Any = None

        def law(self, x, u):
            return (self.table[0] * u[0] ** self.order,)

    first = Power(order=2, table=np.array([1.0]))
    assert compiled(first) is compiled(Power(order=2, table=np.array([1.0])))
    for other in (replace(first, order=3), replace(first, table=np.array([5.0]))):
        assert compiled(other) is not compiled(first)
        expected = other.table[0] * 2.0**other.order
        assert one_step(other, np.zeros(1), np.array([2.0]), step=1.0)[0] == pytest.approx(expected)
    beam = CamBeam()
    assert compiled(beam) is compiled(replace(beam, gain=5.0))


def test_a_parameter_outside_its_bounds_is_named():
    Linear().check()
    with pytest.raises(UserError, match=r"Linear: parameter damping = -1 1/s is outside \[0, 150\]"):
        Linear(damping=-1.0).check()
    with pytest.raises(UserError, match="parameter gain = nan"):
        Linear(gain=float("nan")).check()
    with pytest.raises(ValueError, match=r"value 3\.0"):
        bounded(3.0, 0.0, 2.0, unit="N/m")


def test_a_system_without_a_learned_part_takes_no_weights():
    with pytest.raises(UserError, match="Linear has no learned part, but 3 weights"):
        Linear().with_weights(np.zeros(3))
    hybrid = structure("hybrid")
    with pytest.raises(UserError, match="a network weight is not finite"):
        hybrid.with_weights(np.full(len(hybrid.weights), np.nan)).check()


def test_values_go_in_and_out_by_name():
    beam = CamBeam()
    values = beam.values + 1e-3
    moved = beam.with_values(values)
    np.testing.assert_array_equal(moved.values, values)
    assert moved.named["gain"] == beam.gain + 1e-3
    assert moved.delay == beam.input_delay + 1e-3


# Mistakes in what a class declares


DECLARED: dict[str, Any] = {
    "states twice": ({"states": ("q [rad]", "q [rad]")}, "q"),
    "inputs twice": ({"inputs": ("u [V]", "u [V]")}, "u"),
    "outputs twice": ({"outputs": ("q", "q")}, "q"),
    "one string": ({"states": "q [rad]"}, "q"),
    "contact on no state": ({"contacts": (Dry(on="speed", level=1.0),)}, "speed"),
    "two contacts on one": ({"contacts": (Dry(on="v", level=1.0), Viscous(on="v", viscous=1.0))}, "v"),
    "contact with Runge-Kutta": ({"contacts": (Dry(on="v", level=1.0),), "stepper": RungeKutta()}, "ImplicitFriction"),
    "contact of no parameter": ({"contacts": (Dry(on="v", level="grip"),)}, "grip"),
    "delay of no input": ({"delays": {"torque": 0.1}}, "torque"),
    "delay by no parameter": ({"delays": {"u": "late"}}, "late"),
    "delay before its time": ({"delays": {"u": -0.1}}, "-0.1"),
    "deflections of one name": (
        {"contacts": tuple(Bristles(on=v, level=1.0, stiffness=9.0) for v in ("q", "v"))},
        "deflection",
    ),
}


@pytest.mark.parametrize("case", DECLARED)
def test_a_declaration_that_does_not_fit_is_reported_when_the_class_is_made(case):
    changes, named = DECLARED[case]
    body: dict[str, Any] = {
        "states": ("q [rad]", "v [rad/s]"),
        "inputs": ("u [V]",),
        "law": lambda self, x, u: (x[1], u[0]),
        **changes,
    }
    with pytest.raises(UserError) as raised:
        type("Cart", (System,), body)
    reported(raised, "Cart", named)


def reported(raised, *parts):
    """One line that names the class and what is wrong."""
    line = str(raised.value)
    assert "\n" not in line
    for part in parts:
        assert part in line


def made(law=None, output=None, **body):
    body = {"states": ("q [rad]", "v [rad/s]"), "inputs": ("u [V]",), **body}
    body["law"] = law or (lambda self, x, u: (x[1], u[0]))
    if output:
        body["output"] = output
    kind: Any = type("Cart", (System,), body)
    return dataclass(frozen=True, kw_only=True)(kind)()


def branching(self, x, u):
    return x[1], u[0] if x[0] > 0 else -u[0]


def of_python(self, x, u):
    import math

    return x[1], math.sin(x[0])


def singular(self, x, u):
    return x[1], u[0] / x[1]


LAWS = {
    "too few rates": (lambda self, x, u: (x[1],), "1 values for 2 states"),
    "Python's if": (branching, "select"),
    "Python's max": (lambda self, x, u: (x[1], max(x[0], 0.0)), "maximum"),
    "Python's sine": (of_python, "mathematics"),
    "numpy's sine": (lambda self, x, u: (x[1], np.sin(x[0])), "core.mathematics"),
    "text": (lambda self, x, u: "ab", "gives 'ab'"),
    "another unpacking": (lambda self, x, u: (x[1], sum(a for a, b, c in [x]) + u[0]), "unpack"),
    "no numbers": (lambda self, x, u: (x[1], "fast"), "law"),
    "nothing": (lambda self, x, u: None, "law"),
    "not finite at rest": (singular, "finite for v"),
}


@pytest.mark.parametrize("case", LAWS)
def test_a_law_that_can_not_be_one_is_reported_when_it_is_traced(case):
    law, named = LAWS[case]
    with pytest.raises(UserError) as raised:
        simulate(made(law), np.zeros(2), np.zeros((3, 1)), step=0.1)
    reported(raised, "Cart", named)


@pytest.mark.parametrize(
    ("output", "outputs", "named"),
    [
        (lambda self, x, u: x[0], ("force [N]", "q"), "1 values for 2 outputs"),
        (lambda self, x, u: (x[0], u[0], x[1]), ("force [N]", "q"), "3 values for 2 outputs"),
        (lambda self, x, u: (u[0] / x[0],), ("force [N]",), "finite for force"),
        (None, ("force [N]",), "force"),
    ],
)
def test_an_output_map_that_does_not_fit_is_reported(output, outputs, named):
    with pytest.raises(UserError) as raised:
        simulate(made(output=output, outputs=outputs), np.zeros(2), np.zeros((3, 1)), step=0.1)
    reported(raised, "Cart", named)


def test_a_block_that_is_asked_for_other_features_is_reported():
    block = Softsign(features=3, units=2)
    with pytest.raises(UserError) as raised:
        simulate(made(lambda self, x, u: (x[1], block([x[0], u[0]])[0])), np.zeros(2), np.zeros((3, 1)), step=0.1)
    reported(raised, "Cart", "3 features")


def test_a_contact_whose_level_is_not_finite_is_reported():
    def level(self, x, u):
        return 1.0 / x[0]

    with pytest.raises(UserError) as raised:
        simulate(made(contacts=(Dry(on="v", level="grip"),), grip=level), np.zeros(2), np.zeros((3, 1)), step=0.1)
    reported(raised, "Cart", "the step is not finite")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("shown", "reconstructible"),
        ("remembered", "delay_line"),
        ("hidden", "unobserved"),
        ("observed", "states_from_record"),
    ],
)
def test_a_system_of_an_earlier_edition_is_given_the_new_name(old, new):
    with pytest.raises(UserError, match=rf"Former: {old} .*{new}"):
        type("Former", (System,), {old: property(lambda self: [0])})
