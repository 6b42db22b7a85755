"""Bands of predictions some samples ahead."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.mathematics import sin
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.extensions.horizon_bands.horizon_bands import NOTE, horizon_bands, noted
from hybrid_sysid_ros.extensions.horizon_bands.live import LiveDeviations
from hybrid_sysid_ros.identification import Part, identify, prepare
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.validation.left_out import LeftOut
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import load as load_rig
from tests.linear_bench import bench, held_levels, record_of
from tests.test_bands import Integrator

ROOT = Path(__file__).parents[4]
SAMPLING = Sampling(step=0.01, period=0.05, initial="first")


def level(gain: float = 2.0):
    u = held_levels(0, 2001, hold=2001)
    return record_of(u, np.concatenate([[0.0], np.cumsum(gain * 0.01 * u[:-1, 0])])[:, None], 0.01)


def test_the_width_is_the_error_that_a_left_out_gain_makes() -> None:
    """Under a constant input a gain that is off by d errs by d |u| t after t, in each prediction alike."""
    record = level()
    experiment, off = prepare(record, Integrator(), SAMPLING), Integrator().with_values([2.1])
    block = LeftOut(record=0, samples=slice(0, experiment.samples), system=off)
    found = noted(Integrator(), [experiment], [block])
    assert found is not None
    expected = 0.1 * abs(record.input[0, 0]) * 0.05 * np.array(found["ahead"])
    for widths in found["widths"].values():
        wide = np.array(widths)[:, 0]
        np.testing.assert_allclose(wide / wide[-1], expected / expected[-1], rtol=1e-6)
        assert np.all(wide >= expected * (1.0 - 1e-9))
    assert noted(Integrator(), [experiment], []) is None


def test_a_state_that_no_record_shows_begins_no_prediction() -> None:
    """It would come from the free run, whose error is none of a prediction."""

    class Hidden(Integrator):
        def record_map(self) -> RecordMap:
            return replace(super().record_map(), unobserved=[0])

    experiment = prepare(level(), Hidden(), SAMPLING)
    block = LeftOut(record=0, samples=slice(0, experiment.samples), system=Hidden())
    assert noted(Hidden(), [experiment], [block]) is None


def test_parts_whose_errors_differ_widen_bands() -> None:
    """Mean squares of 1 and 4 have 2 2.5^2 / 4.5 degrees of freedom (Satterthwaite), of which Student's t is wider."""
    record = level()
    experiment = prepare(record, Integrator(), SAMPLING)
    half = experiment.samples // 2
    parts = slice(0, half), slice(half, experiment.samples)
    pairs = zip(parts, (2.1, 2.2), strict=True)
    blocks = [LeftOut(record=0, samples=part, system=Integrator().with_values([gain])) for part, gain in pairs]
    found = noted(Integrator(), [experiment], blocks)
    assert found is not None
    largest = 0.2 * abs(record.input[0, 0]) * 0.05 * np.array(found["ahead"])
    factor = student.ppf(0.95, 12.5 / 4.5) / norm.ppf(0.95)
    np.testing.assert_allclose(np.array(found["widths"]["0.9"])[:, 0], factor * largest, rtol=1e-6)


def test_unseen_predictions_lie_within_their_bands_and_farther_ones_have_wider_bands() -> None:
    rig = load_rig("cam_beam")
    clean = bench(samples=12001)
    noise = 0.01 * clean.output.std() * np.random.default_rng(0).normal(size=clean.output.shape)
    record = replace(clean, output=clean.output + noise)
    model = identify([record], rig, "linear", sampling=Sampling(), part=Part(stop=0.6), refine=True)
    experiment = experiment_of(model, record, part=Part(start=0.6))
    found = horizon_bands(model, experiment)
    assert found is not None
    assert 0.8 < found.held[0.9].mean() <= 1.0
    assert 0.3 < found.held[0.5].mean() < 0.8
    farther = replace(experiment, **{key: 3.0 * getattr(experiment, key) for key in ("inputs", "outputs", "states")})
    wider = horizon_bands(model, farther)
    assert wider is not None
    assert np.all(wider.halves[0.9] > 1.5 * found.halves[0.9])
    assert horizon_bands(replace(model, fit={**model.fit, NOTE: None}), experiment) is None


def test_evaluate_says_what_bands_hold_ahead(call, tmp_path: Path) -> None:
    model, bag = ROOT / "trained/wheel_motor/model", ROOT / "bags/wheel_motor_swept_sine"
    report = tmp_path / "report.html"
    status, out, _ = call(app.main, "hybrid-sysid", "evaluate", model, bag, "--ahead", "--json", "--report", report)
    own = json.loads(out)["records"]["wheel_motor_swept_sine"]["horizon_bands"]
    assert status == 0
    assert 0.7 < np.mean(own["speed"]["0.9"]["held"]) <= 1.0
    assert "Predictions from measured states" in report.read_text(encoding="utf-8")
    older = hs.load_model(model)
    replace(older, notes={}).save(tmp_path / "old")
    status, _, error = call(app.main, "hybrid-sysid", "evaluate", tmp_path / "old", bag, "--ahead")
    assert (status, "has no bands over the horizon" in error) == (2, True)


class HalfThrough(System):
    """x' = u, y = x + u / 2, z = sin x."""

    states, inputs, outputs = ("place [m]",), ("push [m/s]",), ("y [m]", "z")

    def law(self, x, u):
        return (u[0],)

    def output(self, x, u):
        return x[0] + 0.5 * u[0], sin(x[0])


def test_the_deviation_of_an_estimate_is_propagated_to_its_outputs() -> None:
    """var y = P_xx + P_xd + P_dd / 4, and the sine's slope at 0 is 1 but for the cube of the deviation."""
    covariance = np.array([[4e-4, 1e-4], [1e-4, 9e-4]])
    estimate: Any = SimpleNamespace(state=np.zeros(1), disturbance=np.zeros(1), covariance=covariance)
    check = LiveDeviations(HalfThrough())
    assert {str(value) for value in check.report()[1].values()} == {"nan"}
    check.see(estimate, np.array([np.nan]))
    words, values = check.report()
    assert words == ""
    assert list(values) == ["deviation_y [m]", "deviation_z"]
    expected = np.sqrt([4e-4 + 1e-4 + 0.25 * 9e-4, 4e-4])
    np.testing.assert_allclose([float(str(value)) for value in values.values()], expected, rtol=1e-4)
