"""Systems about another one: what a stabiliser and offsets of rates make of it, against closed forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm

from hybrid_sysid_ros.core import Dry, System, simulate, step_with_jacobian
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.core.wrappers import RateDisturbanceModel, Stabilised
from hybrid_sysid_ros.support.errors import UserError
from tests.upright import GAINS, RATE, Upright

STEP = 0.01


@dataclass(frozen=True, kw_only=True)
class Rubbing(System):
    """A mass with dry friction, whose deflection comes behind the law's states."""

    states = ("place [m]", "speed [m/s]")
    inputs = ("push [m/s^2]",)
    outputs = ("place", "speed")
    contacts = (Dry(on="speed", level=0.5),)

    def law(self, x, u):
        return x[1], u[0]


def matrices() -> tuple[np.ndarray, np.ndarray]:
    return np.array([[0.0, 1.0], [RATE**2, 0.0]]), np.array([[0.0], [1.0]])


def test_a_stabilised_system_moves_as_the_closed_loop_in_continuous_time():
    a, b = matrices()
    held, x0 = a - b @ np.array(GAINS), np.array([0.3, -0.2])
    states = simulate(Stabilised(physics=Upright(), gains=GAINS), x0, np.zeros((100, 1)), step=STEP)
    assert np.allclose(states[-1], expm(held * 100 * STEP) @ x0, atol=1e-8)


def test_what_is_added_to_a_stabiliser_moves_the_equilibrium():
    added, k = 0.7, GAINS[0][0]
    states = simulate(Stabilised(physics=Upright(), gains=GAINS), np.zeros(2), np.full((1500, 1), added), step=STEP)
    assert np.allclose(states[-1], [added / (k - RATE**2), 0.0], atol=1e-9)


def test_its_slopes_are_those_of_the_closed_loop():
    a, b = matrices()
    whole = expm(np.block([[a - b @ np.array(GAINS), b], [np.zeros((1, 3))]]) * STEP)[:2]
    _, jacobian = step_with_jacobian(Stabilised(physics=Upright(), gains=GAINS), np.zeros(2), np.zeros(1), step=STEP)
    assert np.allclose(jacobian, whole, atol=1e-8)


def test_parameters_are_those_of_the_system_within():
    system = Stabilised(physics=RateDisturbanceModel(physics=Upright(), on=("speed",)), gains=((16.0, 5.0, 0.0),))
    assert system.named == {"rate": RATE}
    assert system.with_values([2.0]).named == {"rate": 2.0}


def test_an_offset_of_a_rate_is_a_constant_force():
    offset, seconds = 0.4, 1.5
    system = RateDisturbanceModel(physics=Upright(), on=("speed",))
    assert [str(item) for item in system.states] == ["angle [rad]", "speed [rad/s]", "speed_offset [rad/s/s]"]
    states = simulate(system, np.array([0.0, 0.0, offset]), np.zeros((150, 1)), step=STEP)
    assert states[-1, 0] == pytest.approx(offset / RATE**2 * (np.cosh(RATE * seconds) - 1.0), rel=1e-6)
    assert states[-1, 2] == offset


def test_friction_is_met_by_what_acts_and_by_the_offset():
    """Within the level it sticks whatever pushes it: an input, or an offset of its speed's rate."""
    system = RateDisturbanceModel(physics=Rubbing(), on=("speed",))
    stuck = simulate(system, np.array([0.0, 0.0, 0.3]), np.full((100, 1), 0.15), step=STEP)
    assert np.all(stuck[:, :2] == 0.0)
    slid = simulate(system, np.array([0.0, 0.0, 0.3]), np.full((100, 1), 0.3), step=STEP)
    assert slid[-1, 1] == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize("within", [Upright(), Rubbing()])
def test_the_forms_agree(within):
    system = Stabilised(physics=RateDisturbanceModel(physics=within, on=("speed",)), gains=((16.0, 5.0, 0.0),))
    x, u = np.array([0.2, -0.6, 0.1]), np.array([0.4])
    made = simulate(system, x, u[None], step=STEP)[-1]
    assert np.allclose(made, np.array(symbolic_step(system, step=STEP)(x, u)).ravel(), atol=1e-14)


def test_an_offset_of_no_state_is_refused():
    with pytest.raises(UserError, match="weight is no state; known are angle, speed"):
        RateDisturbanceModel(physics=Upright(), on=("weight",))
