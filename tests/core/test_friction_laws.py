"""The laws of friction in four experiments, against what each law says of them."""

import numpy as np
import pytest

from hybrid_sysid_ros.core.friction.experiments import break_away, friction_over_speed, led, pre_sliding, stick_slip
from hybrid_sysid_ros.core.friction.laws import LAWS, law
from hybrid_sysid_ros.support.errors import UserError

COULOMB, STATIC, STRIBECK_SPEED, VISCOUS = 1.0, 1.5, 0.05, 0.4


@pytest.mark.parametrize("name", ["stribeck", "lugre", "maxwell"])
def test_steady_friction_is_stribeck_s_curve(name):
    curve = friction_over_speed(law(name), speeds=5)
    fast = np.abs(curve.x) > 0.01  # below, bristles are still bending
    expected = COULOMB + (STATIC - COULOMB) * np.exp(-((curve.x / STRIBECK_SPEED) ** 2)) + VISCOUS * np.abs(curve.x)
    np.testing.assert_allclose(curve.y[fast], (np.sign(curve.x) * expected)[fast], rtol=2e-3)


def test_dahl_s_loop_is_its_closed_form():
    """From rest F = Fc (1 - exp(-s0 x / Fc)); after a reversal at F1 it is -Fc + (F1 + Fc) exp(-s0 (x1 - x) / Fc)."""
    system, speed, h = law("dahl", {"viscous": 0.0}), 0.01, 1e-4
    time = h * np.arange(12_000.0)
    end = np.where(time < 0.6, speed * time, speed * (1.2 - time))
    friction, place = led(system, end, np.where(time < 0.6, speed, -speed))
    up, down = slice(500, 5900), slice(6500, None)
    first = COULOMB * (1.0 - np.exp(-500.0 * place[up]))
    np.testing.assert_allclose(friction[up], first, atol=5e-3)
    top = COULOMB * (1.0 - np.exp(-500.0 * 0.006))
    back = -COULOMB + (top + COULOMB) * np.exp(-500.0 * (0.006 - place[down]))
    np.testing.assert_allclose(friction[down], back, atol=1e-2)


@pytest.mark.parametrize("name", ["coulomb", "dahl"])
def test_break_away_of_a_constant_level_is_that_level_at_any_rate(name):
    np.testing.assert_allclose(break_away(law(name), rates=4).y, COULOMB, rtol=2e-2)


@pytest.mark.parametrize("name", ["ageing", "lugre", "maxwell"])
def test_break_away_falls_with_the_rate_of_the_force(name):
    """From nearly the static level: known of dry contacts since Rabinowicz."""
    found = break_away(law(name), slowest=0.3, fastest=30.0, rates=4).y
    assert np.all(np.diff(found) < 0.0)
    assert found[0] > 0.95 * STATIC
    assert found[-1] < 1.15 * COULOMB


@pytest.mark.parametrize("name", ["stribeck", "ageing", "stefanski"])
def test_a_block_on_a_drawn_spring_sticks_and_slips_where_friction_falls_with_speed(name):
    block, end = stick_slip(law(name))
    assert np.mean(np.diff(block.y) == 0.0) > 0.4
    assert np.all(20.0 * np.abs(end.y - block.y) < 2.0 * STATIC)


def test_a_block_on_a_drawn_spring_ends_in_steady_sliding_without_a_fall():
    block, end = stick_slip(law("coulomb", {"viscous": 5.0}))
    assert np.ptp((end.y - block.y)[-100:]) < 1e-4
    assert 20.0 * (end.y - block.y)[-1] == pytest.approx(COULOMB + 5.0 * 0.02, rel=1e-2)


@pytest.mark.parametrize("name", ["dahl", "lugre", "maxwell"])
def test_before_sliding_friction_is_a_loop_within_its_level(name):
    loop = pre_sliding(law(name))
    area = np.abs(np.sum(loop.y[1:] * np.diff(loop.x)))
    assert area > 0.0
    assert np.max(np.abs(loop.y)) <= STATIC + VISCOUS * 0.02


@pytest.mark.parametrize("name", [name for name, system in LAWS.items() if "static" in system.named])
def test_static_friction_below_coulomb_friction_is_refused(name):
    with pytest.raises(UserError, match="below Coulomb friction"):
        law(name, {"static": 0.5})


@pytest.mark.parametrize(
    ("name", "values", "told"),
    [
        ("sticky", {}, "unknown"),
        ("dahl", {"static": 2.0}, "no parameter 'static'"),
        ("maxwell", {"stiffness": 0.0}, "stiffness = 0"),
        ("lugre", {"stiffness": float("nan")}, "stiffness"),
        ("coulomb", {"spring": 1.0}, "no parameter 'spring'"),
    ],
)
def test_what_no_law_has_is_refused(name, values, told):
    with pytest.raises(UserError, match=told):
        law(name, values)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_tells_its_equation_source_and_units(name):
    system = LAWS[name]
    assert "F = " in (system.__doc__ or "")
    assert len(system.source) > 20
    assert all(item.unit and item.description for item in system.parameters)
