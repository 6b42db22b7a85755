"""Equilibria and modes, against closed forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from hybrid_sysid_ros.core import Dry, Recurrence, RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import exp, sin
from hybrid_sysid_ros.extensions.trim.equilibrium import equilibrium, modes_of
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class DryPendulum(System):
    """q'' = u - 9 sin q - .6 q' - F sgn q'."""

    states = ("angle [rad]", "rate [rad/s]")
    inputs = ("torque [rad/s^2]",)
    contacts = (Dry(on="rate", level="friction", viscous="damping"),)

    friction: float = bounded(0.2, 0.0, 1.0, unit="rad/s^2")
    damping: float = bounded(0.6, 0.0, 1.0, unit="1/s")

    def law(self, x, u):
        return x[1], u[0] - 9.0 * sin(x[0])


def test_a_pendulum_hangs_where_its_torque_holds_it():
    found = equilibrium(DryPendulum(), {"torque": 4.5})
    np.testing.assert_allclose([*found.states, *found.inputs], [np.pi / 6.0, 0.0, 4.5], atol=1e-9)
    (mode,) = found.modes
    stiffness = 9.0 * np.cos(np.pi / 6.0)
    assert mode.pole == pytest.approx(complex(-0.3, np.sqrt(stiffness - 0.09)))
    assert mode.damping == pytest.approx(0.3 / np.sqrt(stiffness))
    assert mode.oscillates
    np.testing.assert_allclose(mode.shares, 0.5)
    np.testing.assert_allclose(found.gain, [[0.0], [1.0]])


def test_what_is_given_is_held_and_the_rest_is_found():
    found = equilibrium(DryPendulum(), {"angle": 0.4})
    assert found.inputs[0] == pytest.approx(9.0 * np.sin(0.4))
    assert equilibrium(DryPendulum(), {"angle": np.pi}).inputs[0] == pytest.approx(0.0, abs=1e-12)


@dataclass(frozen=True, kw_only=True)
class RubbingCart(System):
    """v' = u - .6 v - F sgn v."""

    states = ("speed [m/s]",)
    inputs = ("push [m/s^2]",)
    contacts = (Dry(on="speed", level="friction", viscous="damping"),)

    friction: float = bounded(0.2, 0.0, 1.0, unit="m/s^2")
    damping: float = bounded(0.6, 0.0, 1.0, unit="1/s")

    def law(self, x, u):
        return (u[0],)


def test_what_viscous_friction_takes_is_pushed_and_dry_one_is_left_out():
    assert equilibrium(RubbingCart(), {"speed": 5.0}).inputs[0] == pytest.approx(3.0)
    assert equilibrium(RubbingCart(), {"push": 3.0}).states[0] == pytest.approx(5.0)


def test_upside_down_one_mode_grows():
    modes = equilibrium(DryPendulum(damping=0.0), {"angle": np.pi}).modes
    assert [mode.pole.real for mode in modes] == pytest.approx([3.0, -3.0]) or [
        mode.pole.real for mode in modes
    ] == pytest.approx([-3.0, 3.0])
    assert not any(mode.oscillates for mode in modes)
    assert {round(mode.damping) for mode in modes} == {-1, 1}


@dataclass(frozen=True, kw_only=True)
class Pair(System):
    """Two lags that don't know of each other, in units of a thousandth and a thousand."""

    states = ("fast [mm]", "slow [km]", "way [m]")
    inputs = ("push [m]",)
    stepper = RungeKutta()

    def law(self, x, u):
        return 5.0 * (1e3 * u[0] - x[0]), 0.5 * (1e-3 * u[0] + 1e-6 * x[0] - x[1]), x[0] * 1e-3 - u[0]


def test_shares_say_which_state_a_mode_moves_whatever_its_unit():
    found = modes_of(equilibrium(Pair(), {"push": 0.3}).transition)
    assert [mode.pole.real for mode in found] == pytest.approx([-5.0, -0.5, 0.0])
    np.testing.assert_allclose([mode.shares for mode in found], np.eye(3), atol=1e-6)


def test_of_equilibria_the_one_nearest_to_zero_is_found():
    """A state that integrates and that nothing depends on stays at zero."""
    assert equilibrium(Pair(), {"push": 0.3}).states[2] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(equilibrium(DryPendulum()).states, 0.0, atol=1e-12)


@dataclass(frozen=True, kw_only=True)
class Falling(System):
    """v' = exp(v) + u^2: never at rest."""

    states = ("speed [m/s]",)
    inputs = ("push [m/s]",)
    stepper = RungeKutta()

    def law(self, x, u):
        return (exp(x[0]) + u[0] * u[0] + 1.0,)


def test_without_an_equilibrium_that_is_reported_with_the_cure():
    with pytest.raises(UserError, match=r"no equilibrium at push 2, or none .*: speed still .* hold other values"):
        equilibrium(Falling(), {"push": 2.0})
    with pytest.raises(UserError, match="'weight' is no state or input; known are angle, rate, torque"):
        equilibrium(DryPendulum(), {"weight": 1.0})


@dataclass(frozen=True, kw_only=True)
class SampledLag(Recurrence):
    """x(k + 1) = .5 x + u, every .1 s."""

    states = ("level [1]",)
    inputs = ("push [1]",)
    period: float = 0.1

    def law(self, x, u):
        return (0.5 * x[0] + u[0],)


def test_a_map_rests_where_it_gives_itself_and_its_poles_are_those_of_time():
    found = equilibrium(SampledLag(), {"push": 1.0})
    assert found.states[0] == pytest.approx(2.0)
    (mode,) = found.modes
    assert mode.pole.real == pytest.approx(np.log(0.5) / 0.1)
