"""Levels of dry friction, against the equations they are named after."""

import casadi
import pytest

from hybrid_sysid_ros.core.friction import rational_stribeck, stribeck

COULOMB, STATIC, SPEED = 0.25, 0.40, 0.3  # N m, N m, rad/s: of the flexible joint


def value(level):
    return float(casadi.evalf(casadi.SX(level)))


def test_stribeck_friction_falls_from_static_to_coulomb():
    assert value(stribeck(0.0, COULOMB, STATIC, SPEED)) == pytest.approx(STATIC, rel=1e-15)
    # Armstrong-Helouvry et al. (1994): at the Stribeck velocity the excess has fallen to 1/e.
    assert value(stribeck(SPEED, COULOMB, STATIC, SPEED)) == pytest.approx(COULOMB + 0.15 * 0.36787944117144233)
    assert value(stribeck(100 * SPEED, COULOMB, STATIC, SPEED)) == COULOMB


def test_rational_stribeck_friction_falls_to_a_quarter_of_its_excess():
    assert value(rational_stribeck(0.0, COULOMB, 0.15, SPEED)) == pytest.approx(0.40, rel=1e-15)
    assert value(rational_stribeck(SPEED, COULOMB, 0.15, SPEED)) == pytest.approx(COULOMB + 0.15 / 4)  # 1 / (1 + 1)^2
    assert value(rational_stribeck(3 * SPEED, COULOMB, 0.15, SPEED)) == pytest.approx(
        COULOMB + 0.15 / 100
    )  # 1 / (1 + 9)^2
    assert value(rational_stribeck(1e4 * SPEED, COULOMB, 0.15, SPEED)) == pytest.approx(COULOMB)


@pytest.mark.parametrize("law", [stribeck, rational_stribeck])
def test_friction_does_not_depend_on_the_direction(law):
    for speed in (0.01, 0.3, 2.0):
        assert value(law(speed, 1.0, 1.5, 0.2)) == value(law(-speed, 1.0, 1.5, 0.2))


def test_no_excess_is_coulomb_friction_at_every_speed():
    for speed in (0.0, 0.1, 10.0):
        assert value(stribeck(speed, COULOMB, COULOMB, SPEED)) == COULOMB
        assert value(rational_stribeck(speed, COULOMB, 0.0, SPEED)) == COULOMB
