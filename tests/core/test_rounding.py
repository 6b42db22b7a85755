"""Corners of laws and of friction: exact where they are simulated, rounded where a solver needs derivatives."""

from dataclasses import dataclass

import casadi
import numpy as np
import pytest

from hybrid_sysid_ros.core import Bristles, System, simulate
from hybrid_sysid_ros.core.mathematics import clip, dead_zone, rounded, saturate, sided, soft_sign
from hybrid_sysid_ros.core.symbolic import symbolic_step


def traced(function):
    x = casadi.SX.sym("x")
    y = function(x)
    return casadi.Function("f", [x], [y, casadi.jacobian(y, x), casadi.hessian(y, x)[0]])


CORNERS = {
    "sided": (lambda x: sided(x, 3.0, 1.0, over=0.2), lambda x: np.where(x > 0, 3.0, 1.0) * x),
    "clip": (lambda x: clip(x, -0.5, 0.7, over=0.2), lambda x: np.clip(x, -0.5, 0.7)),
}
GRID = np.linspace(-2.0, 2.0, 801)


@pytest.mark.parametrize("name", CORNERS)
def test_a_corner_is_exact_but_where_it_is_rounded_and_there_twice_differentiable(name):
    function, plain = CORNERS[name]
    exact, (values, slopes, bends) = traced(function), (np.empty(len(GRID)) for _ in range(3))
    with rounded():
        smooth = traced(function)
    for k, x in enumerate(GRID):
        values[k], slopes[k], bends[k] = (float(part) for part in smooth(x))
        assert float(exact(x)[0]) == pytest.approx(plain(x), abs=1e-15)
    away = np.min(np.abs(GRID[:, None] - ([0.0] if name == "sided" else [-0.5, 0.7])), axis=1) >= 0.2
    np.testing.assert_allclose(values[away], plain(GRID)[away], atol=1e-15)
    assert np.max(np.abs(values - plain(GRID))) <= 0.2
    step = GRID[1] - GRID[0]
    np.testing.assert_allclose(np.diff(values), step * (slopes[1:] + slopes[:-1]) / 2, atol=1e-5)
    np.testing.assert_allclose(np.diff(slopes), step * (bends[1:] + bends[:-1]) / 2, atol=2e-3)


def test_a_dead_zone_is_bridged_for_solvers_and_nowhere_flat():
    """Beyond 1.75 of its width nothing changes, and the bridge meets it there with its slope."""
    width, smoothing, over = 30.0, 5.0, 1.75
    exact = traced(lambda x: dead_zone(x, width, smoothing, over=over))
    with rounded():
        bridged = traced(lambda x: dead_zone(x, width, smoothing, over=over))
    assert float(exact(12.0)[0]) == pytest.approx(12.0 - float(saturate(12.0, width, smoothing)))
    grid = np.linspace(-150.0, 150.0, 601)
    found, plain = (np.array([[float(part) for part in each(x)[:2]] for x in grid]) for each in (bridged, exact))
    beyond = np.abs(grid) >= over * width
    np.testing.assert_allclose(found[beyond], plain[beyond], rtol=1e-12)
    assert np.min(plain[:, 1]) < 0.02
    assert np.min(found[:, 1]) > 0.12
    assert np.max(np.abs(np.diff(found, axis=0)), axis=0) == pytest.approx([0.5, 0.0], abs=0.02)


def test_a_soft_sign_turns_round_more_slowly_for_solvers():
    """Its slope at 0 is one over the width; far away both are 1."""
    exact = traced(lambda x: soft_sign(x, 0.2, over=1.0))
    with rounded():
        wide = traced(lambda x: soft_sign(x, 0.2, over=1.0))
    for each, width in ((exact, 0.2), (wide, 1.0)):
        value, slope = (float(part) for part in each(0.0)[:2])
        assert value == 0.0
        assert slope == pytest.approx(1.0 / width)
        assert float(each(-20.0)[0]) == pytest.approx(-1.0)


@dataclass(frozen=True, kw_only=True)
class Sprung(System):
    """A pushed block on bristles of LuGre's kind."""

    states = ("position [m]", "velocity [m/s]")
    inputs = ("push [m/s^2]",)
    contacts = (Bristles(on="velocity", level=2.0, stiffness=300.0, damping=5.0),)

    def law(self, x, u):
        return x[1], u[0]


def test_rounded_bristles_tend_to_exact_ones_and_have_slopes_without_jumps():
    system, x, u = Sprung(), np.array([0.0, 0.01, 0.003]), np.array([1.0])
    exact = simulate(system, x, u[None], step=0.005)[-1]
    for smoothing, off in ((1e-3, 1e-4), (1e-6, 1e-9)):
        step = symbolic_step(system, step=0.005, smoothing=smoothing)
        np.testing.assert_allclose(np.array(step(x, u)).ravel(), exact, atol=off)
    step = symbolic_step(system, step=0.005, smoothing=0.02)
    slopes = casadi.Function(
        "s", [a := casadi.SX.sym("x", 3), b := casadi.SX.sym("u")], [casadi.jacobian(step(a, b), a)]
    )
    along = np.array([np.array(slopes([0.0, v, 0.003], 0.5)).ravel() for v in np.linspace(-0.2, 0.2, 2001)])
    assert np.max(np.abs(np.diff(along, axis=0))) < 0.02  # 0.0002 m/s apart


def test_bristles_at_rest_do_not_creep_when_they_are_rounded():
    """Held by a constant push below the level, for ten seconds."""
    step = symbolic_step(Sprung(), step=0.005, substeps=2000, smoothing=0.02)
    state = np.array(step([0.0, 0.0, 1.0 / 300.0], [1.0])).ravel()
    np.testing.assert_allclose(state, [0.0, 0.0, 1.0 / 300.0], atol=1e-9)
