"""Bounds that are moved in by the band of the prediction: known bands of a linear system, and loops that keep them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtri

from hybrid_sysid_ros.control import ExactMpc, StageTerm
from hybrid_sysid_ros.extensions.shared import scenarios
from hybrid_sysid_ros.extensions.shared.drawn_scenarios import plant_near
from hybrid_sysid_ros.extensions.shared.scenarios import Scenario
from hybrid_sysid_ros.extensions.shared.steady_motion import jacobian_at
from hybrid_sysid_ros.extensions.tightening.tightening import Tightening, _jacobians, _regulator, tightened
from hybrid_sysid_ros.support.errors import UserError
from tests.control.two_inputs import PROBLEM, Carts

CARTS, BOUND = Carts(), 0.2
BOUNDED = replace(
    PROBLEM,
    output_scales=(1.0,),
    output_weights=(50.0, 2.0),
    smoothing=0.0,
    state_high=(BOUND, np.inf, np.inf, np.inf),
    soft_linear=(1e3,),
).sized(CARTS)
ERRORS = (1e-3, 1e-3, 5e-3, 5e-3)
FIELDS: dict[str, Any] = {"share": 0.999, "between": [[0.0, 0.0], [0.15, 0.15]], "states": ERRORS}


def test_the_open_band_of_a_linear_system_is_that_of_its_powers():
    found = tightened(CARTS, BOUNDED, Tightening(**FIELDS, feedback=False))
    _, a, _ = jacobian_at(CARTS, BOUNDED, np.zeros(4), np.zeros(2), output=False)
    whole, factor = np.linalg.matrix_power(a, BOUNDED.substeps), ndtri(1.0 - 0.001 / BOUNDED.horizon)
    for stage in (1, 5, 12):
        power = np.linalg.matrix_power(whole, stage)
        band = factor * np.sqrt(np.diag(power @ np.diag(np.square(ERRORS)) @ power.T))
        np.testing.assert_allclose([margin[stage - 1] for margin in found.state_margins], band, rtol=1e-6)
    np.testing.assert_allclose(found.weights.high[:, 0], BOUND - np.array(found.state_margins[0]))
    assert found.stage_weights.high[0, 0] == BOUND


def test_feedback_narrows_a_band_and_uncertainty_widens_it():
    more: dict[str, Any] = {"parameters": 0.1, "disturbance": (0.05, 0.05)}
    closed, open_one = (tightened(CARTS, BOUNDED, Tightening(**FIELDS, **more, feedback=on)) for on in (True, False))
    plain = tightened(CARTS, BOUNDED, Tightening(**FIELDS))
    assert closed.state_margins[0][-1] < open_one.state_margins[0][-1]
    assert plain.state_margins[0][-1] < closed.state_margins[0][-1]


def test_a_term_has_the_band_of_its_state():
    term = (StageTerm(name="first_high", value="2 * first", high=0.4),)
    found = tightened(CARTS, replace(BOUNDED, terms=term), Tightening(**FIELDS))
    np.testing.assert_allclose(found.terms[0].margin, 2.0 * np.array(found.state_margins[0]), rtol=1e-9)


def test_a_term_with_a_parameter_of_the_stage_has_that_stages_band():
    """Such as an obstacle that moves, whose derivative does."""
    factors = np.linspace(0.5, 3.0, BOUNDED.horizon)
    term = (StageTerm(name="scaled", value="factor * first", high=4.0),)
    problem = replace(BOUNDED, terms=term, stage_parameters=(("factor", tuple(factors.tolist())),))
    found = tightened(CARTS, problem, Tightening(**FIELDS))
    np.testing.assert_allclose(found.terms[0].margin, factors * np.array(found.state_margins[0]), rtol=1e-9)


def test_a_term_with_an_input_has_the_band_of_what_the_feedback_answers():
    """In the first stage the plan's input is given; in the second u = -K (x + e), with e as large as x was at first."""
    term = (StageTerm(name="power", value="first_force + 0.0 * first", high=50.0),)
    found = tightened(CARTS, replace(BOUNDED, terms=term), Tightening(**FIELDS))
    margins = np.array(found.terms[0].margin)
    assert margins[0] == 0.0
    _, a, b = _jacobians(CARTS, BOUNDED, [], np.zeros(4), np.zeros(2))
    gains, errors = _regulator(CARTS, BOUNDED, np.zeros(2)), np.diag(np.square(ERRORS))
    asked = ndtri(1.0 - 0.001 / BOUNDED.horizon) * np.sqrt((gains @ (a @ errors @ a.T + errors) @ gains.T)[0, 0])
    assert margins[1] == pytest.approx(asked, rel=1e-6)
    assert b.shape == (4, 2)


def test_the_stated_share_of_loops_keeps_a_bound_that_the_plain_problem_does_not():
    asked = Tightening(**FIELDS, parameters=0.05)
    drawn = [loop(np.random.default_rng([9, number])) for number in range(300)]
    kept = []
    for problem in (BOUNDED, tightened(CARTS, BOUNDED, asked)):
        runs = [run for run, _ in scenarios.run_many(ExactMpc(CARTS, problem), drawn)]
        kept.append(np.mean([run.excess <= 0.0 for run in runs]))
    assert kept[0] < 0.95
    assert kept[1] >= 0.999


def loop(random: np.random.Generator) -> Scenario:
    """Steps to 0.25 and back, with errors of the estimates, on a plant near the model."""
    periods, n, m = 40, 4, 2
    wanted = np.where(np.arange(periods + BOUNDED.horizon - 1) % 30 < 20, 0.25, 0.0)
    return Scenario(
        plant=plant_near(CARTS, 0.05, random),
        begins=np.arange(periods) == 0,
        states=np.zeros((periods, n)),
        inputs=np.zeros((periods, m)),
        references=np.column_stack([wanted, wanted]),
        disturbances=np.zeros((periods, m)),
        pushes=np.zeros((periods, n)),
        state_errors=random.normal(size=(periods, n)) * np.array(ERRORS),
        disturbance_errors=np.zeros((periods, m)),
        input_errors=np.zeros((periods, m)),
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"share": 1.0}, "share is 1.0; it needs a number from 0.5"),
        ({"share": float("nan")}, "share is nan"),
        ({"states": (-1.0,)}, r"states is \(-1.0,\); it needs numbers not below 0"),
        ({"states": (1.0, 2.0)}, "states has 2 numbers: it needs 4"),
        ({"disturbance": float("nan")}, "disturbance is nan"),
        ({"parameters": "many"}, "parameters is"),
        ({"periods": -1}, "periods is -1"),
        ({"feedback": "yes"}, "feedback is 'yes'; it must be true or false"),
        ({"between": [[0.0, 0.0]]}, "give two outputs, of finite numbers"),
        ({"between": [[0.0], ["x"]]}, "between is"),
        ({"between": [[0.0], [float("nan")]]}, "give two outputs, of finite numbers"),
        ({"shares": 0.9}, "unknown key 'shares'"),
    ],
)
def test_what_is_no_tightening_is_refused(given, said):
    with pytest.raises(UserError, match=said):
        tightened(CARTS, BOUNDED, Tightening.declared({**FIELDS, **given}))


def test_a_tightening_that_leaves_nothing_names_the_bound_and_the_stage():
    narrow = replace(BOUNDED, state_low=(0.19, -np.inf, -np.inf, -np.inf))
    with pytest.raises(UserError, match=r"leaves nothing of first at stage 1: its bounds 0\.19 and 0\.2 move in by"):
        tightened(CARTS, narrow, Tightening(**{**FIELDS, "states": (0.01, 0.0, 0.0, 0.0)}))
    with pytest.raises(UserError, match="first has a margin of -1 at stage 1"):
        replace(BOUNDED, state_margins=((-1.0,), (0.0,), (0.0,), (0.0,))).sized(CARTS)
