"""Dry-friction levels, against the equations they are named after."""

import casadi
import pytest
from hybrid_sysid_ros.core.casadi_form import symbolic

from hybrid_sysid_ros.core import COMPILED
from hybrid_sysid_ros.core.friction import rational_stribeck, stribeck

COULOMB, STATIC, SPEED = 0.25, 0.40, 0.3  # N m, N m, rad/s: of the flexible joint


@pytest.fixture(params=["compiled", "casadi"])
def operations(request):
    return COMPILED if request.param == "compiled" else symbolic()


def value(level):
    return float(casadi.evalf(level)) if isinstance(level, casadi.SX | casadi.DM) else float(level)


def test_stribeck_friction_falls_from_static_to_coulomb(operations):
    level = stribeck(operations)
    assert value(level(0.0, COULOMB, STATIC, SPEED)) == pytest.approx(STATIC, rel=1e-15)
    # Armstrong-Helouvry et al. (1994): at the Stribeck velocity the excess has fallen to 1/e.
    assert value(level(SPEED, COULOMB, STATIC, SPEED)) == pytest.approx(COULOMB + 0.15 * 0.36787944117144233)
    assert value(level(100 * SPEED, COULOMB, STATIC, SPEED)) == COULOMB


def test_rational_stribeck_friction_falls_to_a_quarter_of_its_excess(operations):
    level = rational_stribeck(operations)
    assert value(level(0.0, COULOMB, 0.15, SPEED)) == pytest.approx(0.40, rel=1e-15)
    assert value(level(SPEED, COULOMB, 0.15, SPEED)) == pytest.approx(COULOMB + 0.15 / 4)  # 1 / (1 + 1)^2
    assert value(level(3 * SPEED, COULOMB, 0.15, SPEED)) == pytest.approx(COULOMB + 0.15 / 100)  # 1 / (1 + 9)^2
    assert value(level(1e4 * SPEED, COULOMB, 0.15, SPEED)) == pytest.approx(COULOMB)


@pytest.mark.parametrize("law", [stribeck, rational_stribeck])
def test_friction_does_not_depend_on_the_direction(operations, law):
    level = law(operations)
    for speed in (0.01, 0.3, 2.0):
        assert value(level(speed, 1.0, 1.5, 0.2)) == value(level(-speed, 1.0, 1.5, 0.2))


def test_no_excess_is_coulomb_friction_at_every_speed(operations):
    for speed in (0.0, 0.1, 10.0):
        assert value(stribeck(operations)(speed, COULOMB, COULOMB, SPEED)) == COULOMB
        assert value(rational_stribeck(operations)(speed, COULOMB, 0.0, SPEED)) == COULOMB
