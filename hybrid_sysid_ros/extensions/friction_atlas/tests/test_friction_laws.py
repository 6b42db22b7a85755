"""The laws of friction in four experiments, against what each law says of them."""

import numpy as np
import pytest

from hybrid_sysid_ros.extensions.friction_atlas.experiments import (
    break_away,
    friction_over_speed,
    led,
    pre_sliding,
    stick_slip,
)
from hybrid_sysid_ros.extensions.friction_atlas.laws import LAWS, law
from hybrid_sysid_ros.support.errors import UserError

COULOMB, STATIC, STRIBECK_SPEED, VISCOUS = 1.0, 1.5, 0.05, 0.4


LIGHT = {"coulomb": COULOMB, "static": STATIC}
HEAVY = {"coulomb": 2000.0, "static": 3000.0}
SOFT, HARD, SLOW = {"stiffness": 2.0}, {"stiffness": 1e8}, {"attraction": 0.01}
SOFTEST = {"stiffness": 1e-3}


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("stribeck", LIGHT),
        ("stribeck", HEAVY),
        ("lugre", LIGHT),
        ("lugre", HEAVY),
        ("lugre", LIGHT | SOFT),
        ("lugre", LIGHT | HARD),
        ("maxwell", LIGHT),
        ("maxwell", LIGHT | SOFT | SLOW),
    ],
)
def test_steady_friction_is_stribeck_s_curve(name, values):
    """Whatever bends, and for how long: also where it bends by far more than the block is led."""
    curve = friction_over_speed(law(name, values), speeds=5)
    excess = (values["static"] - values["coulomb"]) * np.exp(-((curve.x / STRIBECK_SPEED) ** 2))
    expected = np.sign(curve.x) * (values["coulomb"] + excess + VISCOUS * np.abs(curve.x))
    np.testing.assert_allclose(curve.y, expected, rtol=2e-3)


@pytest.mark.parametrize("values", [{}, {"stiffness": 2.0}, {"coulomb": 5000.0}])
def test_steady_friction_of_dahl_is_coulomb_s(values):
    curve = friction_over_speed(law("dahl", values), speeds=5)
    expected = np.sign(curve.x) * (values.get("coulomb", COULOMB) + VISCOUS * np.abs(curve.x))
    np.testing.assert_allclose(curve.y, expected, rtol=2e-3)


@pytest.mark.parametrize("values", [{}, {"memory": 5.0}, {"rest_time": 1e4}])
def test_steady_friction_of_an_ageing_contact_is_that_of_its_age(values):
    """a = 1 / (1 + |v| T / L)."""
    curve, system = friction_over_speed(law("ageing", values), speeds=5), law("ageing", values)
    speed = np.abs(curve.x)
    age = 1.0 / (1.0 + speed * system.named["rest_time"] / system.named["memory"])
    expected = np.sign(curve.x) * (COULOMB + (STATIC - COULOMB) * age + VISCOUS * speed)
    np.testing.assert_allclose(curve.y, expected, rtol=2e-3)


@pytest.mark.parametrize("name", ["dahl", "lugre", "maxwell"])
def test_soft_bristles_break_away_at_their_level(name):
    """Pulled slowly, however far they bend before; a level that falls with speed has begun to, by then."""
    system = law(name, {"stiffness": 20.0})
    found = break_away(system, slowest=0.02, fastest=0.02, rates=1).y[0]
    assert found == pytest.approx(system.named.get("static", COULOMB), rel=0.1)


@pytest.mark.parametrize("name", ["dahl", "lugre", "maxwell"])
@pytest.mark.parametrize("stiffness", [50.0, 1e4, 1e8])
def test_before_sliding_a_loop_shows_how_stiff_bristles_are(name, stiffness):
    """Just after a reversal friction falls as all of them bend back together: they are on the plot at any stiffness."""
    bare = {"viscous": 0.0} | ({"damping": 0.0} if name == "lugre" else {})
    loop = pre_sliding(law(name, {"stiffness": stiffness} | bare))
    top = int(np.argmax(loop.x))
    slope = np.diff(loop.y[top : top + 6]).sum() / np.diff(loop.x[top : top + 6]).sum()
    assert 0.5 * stiffness < slope < 2.5 * stiffness


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


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("coulomb", {}),
        ("dahl", {}),
        ("dahl", {"stiffness": 1.0}),
        ("dahl", SOFTEST),
        ("dahl", SOFTEST | {"viscous": 50.0}),
    ],
)
def test_break_away_of_a_constant_level_is_that_level_at_any_rate(name, values):
    """However far bristles bend before: a block is pushed until it has slid by far more than that."""
    np.testing.assert_allclose(break_away(law(name, values), rates=4).y, COULOMB, rtol=2e-2)


def test_friction_of_a_block_that_swings_is_stefanski_s_in_every_phase():
    """[Fc + (Fs - Fc) exp(-a1 |v| / (|v'| + a2)) sgn(v v')] sgn v along the swing that the drive prescribes."""
    time, turn = 1e-4 * np.arange(80_000.0), 0.5 * np.pi
    place, speed = 0.01 * np.sin(turn * time), 0.01 * turn * np.cos(turn * time)
    friction, _ = led(law("stefanski", {"viscous": 0.0}), place, speed)
    acceleration = -(turn**2) * place
    decay = np.exp(-10.0 * np.abs(speed) / (np.abs(acceleration) + 0.5))
    expected = np.sign(speed) * (COULOMB + (STATIC - COULOMB) * decay * np.sign(speed * acceleration))
    moves = (time > 1.0) & (np.abs(speed) > 0.001) & (np.abs(acceleration) > 0.001)
    np.testing.assert_allclose(friction[moves], expected[moves], atol=5e-3)


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


@pytest.mark.parametrize("damping", [1e3, 1e5])
def test_bristles_of_great_damping_are_a_damper_before_they_slide(damping):
    """F = s1 z', z' = v, where the swing sets out: what is drawn are no spikes of the solution."""
    system = law("lugre", {"damping": damping})
    speed = 4.0 * system.way * 2.0 * np.pi / 4.0
    assert np.max(np.abs(pre_sliding(system).y)) == pytest.approx(damping * speed, rel=0.02)


@pytest.mark.parametrize("name", [name for name, system in LAWS.items() if "static" in system.named])
def test_static_friction_below_coulomb_friction_is_refused(name):
    with pytest.raises(UserError, match="below Coulomb friction"):
        law(name, {"static": 0.5})


@pytest.mark.parametrize(
    ("name", "values", "reported"),
    [
        ("sticky", {}, "unknown"),
        ("dahl", {"static": 2.0}, "no parameter 'static'"),
        ("maxwell", {"stiffness": 0.0}, "stiffness = 0"),
        ("lugre", {"stiffness": float("nan")}, "stiffness"),
        ("coulomb", {"spring": 1.0}, "no parameter 'spring'"),
    ],
)
def test_what_no_law_has_is_refused(name, values, reported):
    with pytest.raises(UserError, match=reported):
        law(name, values)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_tells_its_equation_source_and_units(name):
    system = LAWS[name]
    assert "F = " in (system.__doc__ or "")
    assert len(system.source) > 20
    assert all(item.unit and item.description for item in system.parameters)
