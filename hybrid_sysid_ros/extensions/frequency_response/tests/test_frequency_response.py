"""Frequency responses: the estimate against closed forms, and a model against runs of its own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import dlsim, dlti

from hybrid_sysid_ros import bags
from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.core import rollouts
from hybrid_sysid_ros.extensions.frequency_response.comparison import compared, response_sentence
from hybrid_sysid_ros.extensions.frequency_response.spectral_estimate import frequency_response
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.rigs.rig import load as load_rig
from hybrid_sysid_ros.support.errors import UserError

TRANSITION = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.7]])
GAIN = np.array([[0.0, 0.3], [1.0, 0.0], [0.5, 1.0]])
OUTPUT = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])


def response_of_form(frequencies, period):
    """C (z - A)^-1 B at z = exp(2 pi i f T)."""
    z = np.exp(2j * np.pi * frequencies * period)
    return np.array([OUTPUT @ np.linalg.solve(at * np.eye(3) - TRANSITION, GAIN) for at in z])


def test_estimate_and_its_deviations_are_those_of_the_closed_form():
    system, period, ratios = dlti(TRANSITION, GAIN, OUTPUT, np.zeros((2, 2)), dt=0.01), 0.01, []
    for seed in range(12):
        random = np.random.default_rng(seed)
        inputs = random.normal(size=(6000, 2))
        _, outputs, _ = dlsim(system, inputs)
        found = frequency_response(inputs, outputs + random.normal(size=outputs.shape), period)
        wanted = response_of_form(found.frequencies, period)
        ratios.append(np.real(found.values - wanted) / found.deviations)
        power = np.sum(np.abs(wanted) ** 2, axis=2)  # of white inputs, beside white noise of 1
        assert found.coherence[8:] == pytest.approx(power[8:] / (power[8:] + 1.0), abs=0.15)
    high = np.concatenate([part[8:] for part in ratios]).ravel()  # bands of many lines, over which G changes little
    assert 0.85 < np.mean(np.abs(high) < 1.645) < 0.95


def test_a_record_without_noise_gives_the_closed_form_itself():
    inputs = np.random.default_rng(0).normal(size=(20_000, 2))
    _, outputs, _ = dlsim(dlti(TRANSITION, GAIN, OUTPUT, np.zeros((2, 2)), dt=0.01), inputs)
    found = frequency_response(inputs, outputs, 0.01)
    wanted = response_of_form(found.frequencies, 0.01)
    assert np.max(np.abs(found.values - wanted) / np.abs(wanted).max(axis=0)) < 0.05  # a band holds part of a peak
    assert found.coherence[:8].min() > 0.9999  # of bands of one or two frequencies, where only leakage is left


def test_bad_signals_are_refused():
    inputs = np.random.default_rng(0).normal(size=(2000, 2))
    with pytest.raises(UserError, match="too few"):
        frequency_response(inputs[:200], inputs[:200], 0.01)
    with pytest.raises(UserError, match="no frequency"):
        frequency_response(np.repeat(inputs[:, :1], 2, axis=1), inputs, 0.01)
    with pytest.raises(UserError, match="no frequency"):
        frequency_response(np.zeros((2000, 1)), inputs, 0.01)


@pytest.fixture(scope="module")
def wheel():
    rig = load_rig("wheel_motor")
    model = load(Path("trained/wheel_motor/model"))
    record = bags.read(Path("bags/wheel_motor_random_steps"), rig.signals)
    experiment, sampling = experiment_of(model, record), model.sampling
    starts = np.array([[0, 0, experiment.samples, 0]])
    run = rollouts(
        model.system, starts, experiment.states[:1], experiment.inputs, step=sampling.step, every=sampling.every
    )
    assert experiment.noise is not None
    noisy = run[1] + np.random.default_rng(1).normal(size=run[1].shape) * experiment.noise
    return model, replace(experiment, outputs=noisy)


def test_a_models_own_run_is_inside_of_its_bands(wheel):
    model, experiment = wheel
    found = compared(model, experiment)
    use = found.compared(0)
    assert np.sum(use) >= 8
    assert np.mean(np.abs(found.gain_errors)[use] <= found.gain_limits[use]) >= 0.85
    assert "inside the 90 % band" in response_sentence(found, model.system, 0, 0)


def test_another_gain_is_outside_of_them(wheel):
    model, experiment = wheel
    found = compared(model, replace(experiment, outputs=1.1 * experiment.outputs))
    use = found.compared(0) & (found.gain_limits[:, 0, 0] < 0.4)
    assert np.all(np.abs(found.gain_errors)[use] > found.gain_limits[use])
    assert np.median(found.gain_errors[use]) == pytest.approx(20.0 * np.log10(1.1), abs=0.05)


def test_command_prints_what_the_page_draws(call, tmp_path):
    page = tmp_path / "page.html"
    given = "frequency-response", "trained/wheel_motor/model", "bags/wheel_motor_random_steps"
    status, out, _ = call(app.main, "hybrid-sysid", *given, "--json", "--report", page)
    assert status == 0
    (only,) = json.loads(out)["records"].values()
    assert len(only["speed"]["pwm"]["model"]["gain"]) == len(only["frequencies"])
    assert only["speed"]["pwm"]["sentence"] in page.read_text()


def test_command_refuses_what_has_no_frequency_response(call):
    status, _, error = call(
        app.main, "hybrid-sysid", "frequency-response", "trained/winged_cone/model", "bags/winged_cone_flight"
    )
    assert status == 2
    assert "unstable" in error
