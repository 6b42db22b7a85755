"""Structures: where they begin, their options, and what is refused."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.models import Model, Sampling, build, structure_names
from hybrid_sysid_ros.models.linear import Linear
from hybrid_sysid_ros.models.structure import assemble, options_of, parse
from hybrid_sysid_ros.rigs.cam_beam.system import CamBeam
from hybrid_sysid_ros.support.errors import UserError
from tests.model_samples import BUILT, FROM_DATA, SCALES, started
from tests.structures import RANGE


def test_a_structure_begins_where_no_earlier_fit_leaks_in():
    """The rig's identified values are not the start of a fit."""
    for structure in BUILT:
        system, held = build(structure, CamBeam(), scales=SCALES, seed=0)
        other, _ = build(structure, CamBeam(gain=9.0, coulomb=0.3), scales=SCALES, seed=0)
        for item, value in zip(system.parameters, system.values, strict=True):
            assert item.fixed or value == (item.neutral if item.name in held else item.start)
        np.testing.assert_array_equal(system.values, other.values)
        system.check()


@pytest.mark.parametrize("size", [1.0, 1.1, 1.2, 1.3, 1.4])
def test_a_linear_system_begins_within_its_bounds_to_the_last_digit(size):
    system, _ = build("linear", CamBeam(), scales=np.array([1.0, size, size**3]) * RANGE, seed=0)
    assert isinstance(system, Linear)
    started = system.initialised({item.name: 1e9 for item in system.parameters if not item.fixed})
    started.with_values([item.start for item in started.parameters]).check()


def test_doubtful_terms_are_left_out_and_held_unless_they_are_asked_for():
    plain, held = build("gray", CamBeam(), scales=SCALES, seed=0)
    assert set(held) == {"stribeck_excess", "stribeck_speed", "damping_asymmetry", "creep"}
    assert plain.named["stribeck_excess"] == plain.named["damping_asymmetry"] == plain.named["creep"] == 0.0
    assert plain.named["stribeck_speed"] > 0.0  # a scale of what is zero, and a divisor
    creeping, held = build("gray", CamBeam(), scales=SCALES, seed=0, options={"creep": 1})
    assert "creep" not in held
    assert creeping.named["creep"] == next(item.start for item in creeping.parameters if item.name == "creep")


def test_a_term_that_is_switched_off_does_not_move_the_beam():
    beam, held = build("gray", CamBeam(), scales=SCALES, seed=0, options={"cam": 0, "drive_asymmetry": 0})
    assert {"cam_curvature", "asymmetry"} <= set(held)
    assert isinstance(beam, CamBeam)
    # Without crank and asymmetry the drive is a straight line through the centre: up and down are mirror images.
    beam = dataclasses.replace(beam, centre=0.0, quadratic_stiffness=0.0, friction_slope=0.0)
    up, down = (simulate(beam, np.zeros(2), np.full((200, 1), volts), step=0.005) for volts in (4.0, -4.0))
    np.testing.assert_array_equal(up, -down)


def test_physics_has_its_terms_as_options_and_a_network_its_own():
    assert {"cam", "stribeck", "creep", "starts"} <= set(options_of("gray", CamBeam()))
    assert {"cam", "units", "members", "ridge"} <= set(options_of("hybrid", CamBeam()))
    sensors = {f"position_{quantity}" for quantity in ("gain", "offset", "delay", "window")}
    assert set(options_of("linear", CamBeam())) == {"starts", "input_bias", *sensors}
    for structure in structure_names():
        for name, option in options_of(structure, CamBeam()).items():
            assert option.low <= option.default <= option.high, name


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (
            {"colour": 1},
            "structure black_box has no option colour; it has units, .*ridge, starts, input_bias",
        ),
        ({"units": 0}, "option units = 0 is outside 1 to 32"),
        ({"units": 2.5}, r"option units = 2\.5 must be a whole number"),
        ({"ridge": float("nan")}, "option ridge = nan is outside"),
    ],
)
def test_an_option_that_is_none_is_refused(options, reason):
    with pytest.raises(UserError, match=reason):
        build("black_box", CamBeam(), scales=SCALES, seed=0, options=options)


def test_options_are_written_as_name_and_number():
    assert parse(["units=8", " creep = 1e0"]) == {"units": 8.0, "creep": 1.0}
    assert parse([]) == {}
    for text in ("units", "units=", "units=many", "=8=9"):
        with pytest.raises(UserError, match="write NAME=NUMBER"):
            parse([text])


@pytest.mark.parametrize("structure", sorted(FROM_DATA))
def test_what_is_made_of_its_data_is_not_built_before_them(structure):
    with pytest.raises(UserError, match=f"structure {structure} is selected from data"):
        build(structure, CamBeam(), scales=SCALES, seed=0)


def test_an_unknown_structure_names_those_that_are_known():
    with pytest.raises(UserError, match="structure 'magic' is unknown; choose one of linear, stribeck"):
        build("magic", CamBeam(), scales=SCALES, seed=0)


@pytest.mark.parametrize("structure", sorted(set(structure_names()) - {"linear", "stribeck", "dahl", "lugre", "gray"}))
def test_a_learned_part_needs_its_design_and_its_weights(structure):
    system = started(structure, 0)
    for missing in ({"design": None}, {"weights": None}):
        given: dict[str, Any] = {"design": system.design, "weights": system.weights, **missing}
        with pytest.raises(UserError, match=f"structure {structure}: .*missing"):
            assemble(structure, CamBeam(), **given)
    with pytest.raises(UserError):
        assemble(structure, CamBeam(), design=system.design, weights=system.weights[:-1])


def test_a_rig_of_positions_on_one_side_only_can_be_saved(tmp_path):
    """Records that never cross zero set a range on one side of it."""
    for low, high in ((0.02, 0.11), (-0.11, -0.02)):
        system = CamBeam().trained_on(np.array([low, -1.0]), np.array([high, 1.0]))
        system.check()
        assert (system.range_low, system.range_high) == (low, high)


def test_a_period_is_a_multiple_of_the_step():
    with pytest.raises(UserError, match=r"the period 0\.012 s is no multiple of the step 0\.005 s"):
        Sampling(step=0.005, period=0.012)


@pytest.mark.parametrize(
    ("step", "period"),
    [
        (0.0, 0.05),
        (-0.005, 0.05),
        (0.1, 0.05),
        (math.nan, 0.05),
        (0.005, math.nan),
        (0.005, math.inf),
        (math.inf, math.inf),
        (-math.inf, 0.05),
        (1e308, 1e308),
    ],
)
def test_step_and_period_are_numbers_above_zero(step, period):
    with pytest.raises(UserError, match=r"needs 0 < step <= period <= 1e\+06 s"):
        Sampling(step=step, period=period)


@pytest.mark.parametrize("step", [1e-9, 1e-300, 1e-320, 0.05 / 1001])
def test_a_period_has_no_more_steps_than_can_be_kept(step):
    with pytest.raises(UserError, match=r"more than 1000 of each period of 0\.05 s; take a longer step"):
        Sampling(step=step, period=0.05)
    assert Sampling(step=0.05 / 1000, period=0.05).every == 1000


def test_a_network_counts_with_every_weight():
    system, _ = build("hybrid", CamBeam(), scales=np.ones(3), seed=0)
    names = tuple(item.name for item in system.parameters if not item.fixed)
    physical = Model(
        rig="cam_beam",
        structure="hybrid",
        system=system,
        sampling=Sampling(),
        names=names,
        covariance=np.eye(len(names)),
        training_range={},
    )
    weights = 4 * (3 + 2)  # units: three features, a bias and an output weight each
    assert physical.free_numbers == len(names) + weights
    listed = dataclasses.replace(physical, names=(*names, *(f"weight_{i}" for i in range(weights))))
    assert listed.free_numbers == physical.free_numbers


@pytest.mark.parametrize("structure", ["gray", "hybrid"])
def test_no_spring_pushes_so_no_free_run_grows_without_bound(structure):
    """Ten minutes at full drive from far outside any record: a damped mass on a spring that pulls comes to rest."""
    system, _ = build(structure, CamBeam(), scales=np.array([0.1, 0.4, 5.0]), seed=0)
    bounds = {item.name: item.low for item in system.parameters}
    assert bounds["stiffness"] == 0.0
    system = system.trained_on(np.array([-0.1, -1.0]), np.array([0.1, 1.0]))
    start = np.zeros(len(system.states))
    start[:2] = 3.0, -20.0
    states = simulate(system, start, np.full((120_000, 1), 10.0), step=0.005, every=1000)
    np.testing.assert_allclose(states[-1, :2], states[-2, :2], atol=1e-6)
