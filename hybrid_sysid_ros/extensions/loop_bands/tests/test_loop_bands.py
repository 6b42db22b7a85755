"""Bands of closed loops that are forecast from their commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import hybrid_sysid_ros as hs
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.extensions.loop_bands.loop_bands import DRAWS, NOTE, drawn_error, loop_bands, noted
from hybrid_sysid_ros.identification import prepare
from hybrid_sysid_ros.identification.validation.left_out import LeftOut
from hybrid_sysid_ros.models import Sampling
from tests.command_line import refused
from tests.linear_bench import held_levels, record_of
from tests.test_bands import Integrator

ROOT = Path(__file__).parents[4]
MODEL, BAG = ROOT / "trained/cam_beam/model", ROOT / "bags/beam_swept_sine"
SAMPLING = Sampling(step=0.01, period=0.05, initial="first")


def test_drawn_errors_go_on_as_those_of_left_out_records() -> None:
    """A record whose output wanders beside the integrator by e(k) = .95 e(k-1) + w."""
    u = held_levels(0, 40_001, hold=500)
    wander = lfilter([0.01], [1.0, -0.95], np.random.default_rng(1).normal(size=8001))
    run = np.concatenate([[0.0], np.cumsum(2.0 * 0.01 * u[:-1, 0])])
    output = run + np.interp(np.arange(40_001), 5 * np.arange(8001), wander - wander[0])
    experiment = prepare(record_of(u, output[:, None], 0.01), Integrator(), SAMPLING)
    block = LeftOut(record=0, samples=slice(0, experiment.samples), system=Integrator())
    known = noted(Integrator(), [experiment], [block])
    assert known is not None
    assert known["past"][0] == pytest.approx(0.95, abs=0.05)
    assert known["deviation"] == pytest.approx(0.01, rel=0.1)
    drawn = drawn_error(known, 0.05 * np.arange(20_000, dtype=np.float64), 0.05, 3)
    assert drawn.std() == pytest.approx(wander.std(), rel=0.3)
    assert np.corrcoef(drawn[1:], drawn[:-1])[0, 1] == pytest.approx(0.95, abs=0.02)
    assert noted(Integrator(), [experiment], []) is None


def test_a_loop_s_bands_are_narrower_than_those_of_the_free_run_and_grow_with_its_errors() -> None:
    """The loop answers slow errors: what is left of them is what it is too slow for."""
    model, rig = hs.load_model(MODEL), hs.load_rig("cam_beam")
    record = hs.read_bag(BAG, rig).between(0, 4000)
    found = loop_bands(model, record, rig)
    assert found is not None
    free = hs.load_model(MODEL).free_run(record).bands[0.9]
    assert 0.0 < found.halves[0.9].mean() < 0.8 * float(np.mean(np.asarray(free)))
    assert np.all(found.halves[0.5] < found.halves[0.9])
    known = model.note(NOTE)
    louder = replace(model, notes={**model.notes, NOTE: {**known, "deviation": 4.0 * known["deviation"]}})
    wider = loop_bands(louder, record, rig)
    assert wider is not None
    assert np.all(wider.halves[0.9] > 1.5 * found.halves[0.9])
    assert DRAWS <= 5
    assert loop_bands(replace(model, notes={}), record, rig) is None


def test_evaluate_says_what_the_loop_s_bands_hold(call, tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    options = ("--loop", "--part", "0:0.3")
    status, out, error = call(app.main, "hybrid-sysid", "evaluate", MODEL, BAG, *options, "--json", "--report", report)
    assert status == 0, error
    own = json.loads(out)["records"][BAG.name]["loop_bands"]
    assert 0.0 <= own["0.5"]["held"] <= own["0.9"]["held"] <= 1.0
    assert "forecast from their commands" in report.read_text(encoding="utf-8")
    wheel = ROOT / "trained/wheel_motor/model", ROOT / "bags/wheel_motor_swept_sine"
    refused(call(app.main, "hybrid-sysid", "evaluate", *wheel, "--loop"), "--loop", "wheel_motor")
