"""Backlash with a stated gap, and friction at rest that depends on the direction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import casadi
import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Ageing, Dry, RungeKutta, System, bounded, simulate
from hybrid_sysid_ros.core.mathematics import Scalar, backlash, rounded
from hybrid_sysid_ros.core.rollout import output_of, step_with_jacobian
from hybrid_sysid_ros.identification import prepare
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.models import Sampling

COUNT = 2.0 * np.pi / 4096


@dataclass(frozen=True, kw_only=True)
class Geared(System):
    """A motor turns a load through a gear with play; the only encoder is at the load."""

    states = ("load [rad]", "load_rate [rad/s]", "motor [rad]", "motor_rate [rad/s]")
    inputs = ("torque [N m]",)
    outputs = ("load",)
    stepper = RungeKutta()

    gap: float = bounded(0.03, 0.0, 0.5, start=0.01, unit="rad")
    """Play of the gear, from flank to flank."""
    stiffness: float = bounded(20.0, 1.0, 200.0, start=15.0, unit="N m/rad")
    """Of the teeth."""
    inertia: float = bounded(0.02, 0.001, 1.0, start=0.015, unit="kg m^2")
    """Of the load."""
    damping: float = bounded(0.05, 0.0, 1.0, start=0.03, unit="N m s/rad")
    """Of the motor's bearing."""
    drag: float = bounded(0.03, 0.0, 1.0, start=0.05, unit="N m s/rad")
    """Of the load's bearing."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        load, load_rate, motor, motor_rate = x
        torque = backlash(motor - load, motor_rate - load_rate, gap=self.gap, stiffness=self.stiffness, damping=0.05)
        return (
            load_rate,
            (torque - self.drag * load_rate) / self.inertia,
            motor_rate,
            (u[0] - torque - self.damping * motor_rate) / 0.01,
        )


@dataclass(frozen=True, kw_only=True)
class Coupling(System):
    """The force of a coupling alone."""

    states = ("position [m]", "rate [m/s]")
    inputs = ("push [N]",)
    outputs = ("force [N]",)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return (backlash(x[0], x[1], gap=0.2, stiffness=5.0, damping=2.0),)


@pytest.mark.parametrize(
    ("twist", "rate", "force"),
    [(0.05, 1.0, 0.0), (-0.09, -3.0, 0.0), (0.3, 0.0, 1.0), (0.3, 0.5, 2.0), (0.3, -3.0, 0.0), (-0.3, -0.5, -2.0)],
)
def test_a_coupling_pushes_beyond_its_gap_and_never_pulls(twist, rate, force):
    found = output_of(Coupling(), np.array([twist, rate]), np.zeros(1))
    assert found[0] == pytest.approx(force)


def test_within_the_gap_a_solver_sees_the_way_out():
    with rounded():
        value, jacobian = step_with_jacobian(Coupling(), [0.01, 0.0], [0.0], step=0.01, smoothing=0.01, output=True)
    assert np.isfinite(value).all()
    assert np.isfinite(jacobian).all()


def test_a_coupling_without_a_gap_is_finite_for_solvers():
    """A gap that is identified may end at its bound."""
    twist, gap = casadi.SX.sym("twist"), casadi.SX.sym("gap")
    with rounded():
        force = backlash(twist, 0.5, gap=gap, stiffness=5.0, damping=2.0)
    solver_form = casadi.Function("force", [twist, gap], [force, casadi.gradient(force, twist)])
    assert all(np.isfinite(float(item)) for item in solver_form(0.0, 0.0))
    assert [float(item) for item in solver_form(0.3, 0.0)] == pytest.approx([2.5, 5.0])


def geared(seed: int) -> tuple[System, float]:
    """What steps to and fro tell, and the deviation of its gap."""
    random, true = np.random.default_rng(seed), Geared()
    steps = np.repeat(random.choice([-0.5, -0.2, 0.2, 0.5], size=40), 100)[:, None]
    states = simulate(true, np.zeros(4), steps, step=0.001)[::2]
    outputs = COUNT * np.round(states[:-1, :1] / COUNT)
    record = Record(
        name="gear", time=0.002 * np.arange(len(outputs), dtype=np.float64), input=steps[::2], output=outputs
    )
    started = true.with_values([item.start for item in true.parameters])
    sampling = Sampling(step=0.001, period=0.004)
    found = fit(started, [prepare(record, started, sampling)])
    return found.system, float(np.sqrt(found.covariance[found.names.index("gap"), found.names.index("gap")]))


def test_a_gap_is_identified_from_an_encoder_of_12_bits():
    """Twenty times wider than a count, and the other parameters with it; at corners deviations scatter by records."""
    true, deviations = Geared(), []
    for system, deviation in map(geared, range(3)):
        assert system.named["gap"] == pytest.approx(true.gap, abs=COUNT)
        assert abs(system.named["gap"] - true.gap) < deviation < true.gap
        assert system.named["stiffness"] == pytest.approx(true.stiffness, rel=0.1)
        assert system.named["inertia"] == pytest.approx(true.inertia, rel=0.05)
        deviations.append(deviation)
    assert np.median(deviations) < 0.5 * true.gap


@dataclass(frozen=True, kw_only=True)
class Block(System):
    """A block of 1 kg that is harder to push forwards than backwards."""

    states = ("position [m]", "velocity [m/s]")
    inputs = ("force [N]",)
    contacts: ClassVar[tuple[Any, ...]] = (
        Dry(on="velocity", level="coulomb", direction="direction", viscous=2.0, creep="creep"),
    )
    delays: ClassVar[Mapping[str, str | float]] = {}

    coulomb: float = bounded(1.0, 0.0, 10.0, start=0.6, unit="m/s^2")
    """Level in the mean of both directions."""
    direction: float = bounded(0.5, -0.9, 0.9, start=0.0, spread=0.5, unit="1")
    """Share by which it is higher forwards."""
    creep: float = bounded(0.0, 0.0, 0.1, fixed=True, unit="m/s")
    """Speed below which it is viscous."""

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0]


def moved(system, force, seconds=0.5):
    states = simulate(system, np.zeros(len(system.states)), np.full((int(seconds / 0.001), 1), force), step=0.001)
    return states[-1, 0]


@pytest.mark.parametrize(("force", "moves"), [(1.4, False), (1.6, True), (-0.4, False), (-0.6, True)])
def test_a_block_breaks_away_at_another_force_in_each_direction(force, moves):
    assert (abs(moved(Block(), force)) > 1e-6) == moves
    assert moved(Block(), force) * force >= 0.0


def test_creep_has_the_direction_too():
    """Below break-away a block creeps faster where its friction is lower."""
    creeping = replace(Block(), creep=0.01)
    assert -moved(creeping, -0.3) > 2.0 * moved(creeping, 0.3) > 0.0


def test_rest_alone_may_have_a_direction():
    @dataclass(frozen=True, kw_only=True)
    class Rested(Block):
        contacts: ClassVar[tuple[Any, ...]] = (
            Ageing(on="velocity", level=0.5, excess=1.0, rest_time=1.0, memory=1e-4, rest_direction=0.6),
        )

    assert moved(Rested(), 2.0) == 0.0
    assert moved(Rested(), 2.2) > 0.0
    assert moved(Rested(), -0.8) == 0.0
    assert moved(Rested(), -1.0) < 0.0


def test_a_direction_is_identified():
    random, true = np.random.default_rng(1), Block()
    force = np.repeat(random.uniform(-4.0, 4.0, size=80), 50)[:, None]
    states = simulate(true, np.zeros(2), force, step=0.002)
    record = Record(
        name="block", time=0.002 * np.arange(len(force), dtype=np.float64), input=force,
        output=states[:-1, :1] + 1e-4 * random.normal(size=(len(force), 1)),
    )  # fmt: skip
    started = true.with_values([item.start for item in true.parameters])
    found = fit(started, [prepare(record, started, Sampling(step=0.002, period=0.02))])
    assert found.system.named["direction"] == pytest.approx(0.5, abs=0.02)
    assert found.system.named["coulomb"] == pytest.approx(1.0, abs=0.03)
