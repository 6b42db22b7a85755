"""hybrid-sysid policy certify: what a user sees, and what the configuration makes of the numbers."""

from __future__ import annotations

import dataclasses
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros.commands import app
from hybrid_sysid_ros.control.policy import policy as policies
from hybrid_sysid_ros.control.safety.certificate import FILE
from hybrid_sysid_ros.extensions.policies.commands import policy_certify
from hybrid_sysid_ros.extensions.policies.configured import trial_of
from hybrid_sysid_ros.extensions.policies.mixture import DISTURBED, stratum_of
from hybrid_sysid_ros.models import load
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import check_tolerances
from tests.linear_policies import BEAM, broken_policy, checked
from tests.shared import exact_model
from tests.straight_beam import straight


@pytest.fixture(scope="module")
def linear_folder(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rig with nothing bent, which is linear."""
    folder = tmp_path_factory.mktemp("linear") / "model"
    exact_model(rig, straight(BEAM.system)).save(folder)
    return folder


@pytest.fixture(scope="module")
def planning_folder(policy_folder: Path, linear_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rig's P controller, which means to hold its input, as a policy of a linear model."""
    policy = policies.load(policy_folder)
    hidden, (matrix, bias) = policy.layers
    rows = policy.horizon
    layers = (hidden, (np.repeat(matrix, rows, axis=0), np.repeat(bias, rows)))
    made = dataclasses.replace(policy, layers=layers, model=load(linear_folder).seal)
    folder = tmp_path_factory.mktemp("planning") / "policy"
    checked(made).save(folder)
    return folder


@pytest.fixture(scope="module")
def broken_folder(linear_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The linear model's exact law, but for a share of the instances."""
    problem = dataclasses.replace(BEAM.problem, input_low=(-10.0,), input_high=(10.0,))
    made = broken_policy(dataclasses.replace(BEAM, problem=problem))
    folder = tmp_path_factory.mktemp("broken") / "policy"
    checked(dataclasses.replace(made, model=load(linear_folder).seal)).save(folder)
    return folder


@pytest.fixture
def command(call):
    """Run hybrid-sysid policy certify with arguments; give status, standard output and standard error."""
    return partial(call, app.main, "hybrid-sysid", "policy", "certify")


def test_a_policy_is_certified_and_a_worst_case_shown(command, broken_folder, linear_folder, monkeypatch):
    """Also by the name of the current folder, beside which is kept what is done meanwhile, and gone at the end."""
    monkeypatch.chdir(broken_folder)
    given = (".", "--model", linear_folder, "--seconds", "0.2", "--seed", "3")
    status, out, error = command(*given, "--loops", "12", "--workers", "1")
    assert status == 0, error
    certificate = policies.load(broken_folder).certificate
    assert certificate is not None
    assert (certificate.loops, certificate.ledger[0].seed, certificate.distribution["periods"]) == (12, 3, 10)
    assert certificate.distribution["plant"].startswith("the rig cam_beam")
    assert FILE in out
    assert [path.name for path in broken_folder.parent.iterdir()] == [broken_folder.name]
    worst = certificate.worst[0]
    assert worst["seed"] == 3
    assert f"{worst['input_error']:.3f}" in out
    found = json.loads(command(*given, "--loops", "12", "--workers", "1", "--json")[1])
    assert (found["bounds"], found["worst"][0]) == (certificate.bounds, worst)
    status, _, error = command(*given, "--loops", "11")
    assert status == 2
    assert "12 loops" in error
    assert policies.load(broken_folder).certificate == certificate
    status, out, error = command(*given, "--again", worst["loop"])
    assert status == 0, error
    rows = [line for line in out.splitlines() if line.lstrip("│ ")[:2] in ("0.", "0,")]
    assert len(rows) == 10


def test_an_interrupted_certification_says_what_is_kept(command, broken_folder, linear_folder, monkeypatch):
    def interrupt(subject, *, loops, progress, **_):
        progress("closed loops", 5, loops)
        raise KeyboardInterrupt

    monkeypatch.setattr(policy_certify, "certify", interrupt)
    status, out, error = command(broken_folder, "--model", linear_folder, "--loops", "12", "--seed", "7")
    assert (status, out) == (130, "")
    assert error.splitlines()[-1] == "interrupted: 5 of 12 loops are kept; the same command goes on from there"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--delta", "0"), "say nothing"),
        (("--driver", "nobody"), "not one of 'supervised', 'network', 'exact'"),
        (("--again", "0", "--driver", "nobody"), "not one of 'supervised', 'network', 'exact'"),
        (("--model", "/nowhere"), "/nowhere"),
    ],
)
def test_a_wrong_argument_gets_one_line(command, broken_folder, linear_folder, arguments, words):
    status, _, error = command(broken_folder, "--model", linear_folder, *arguments)
    assert status == 2
    assert error.startswith("error: ")
    assert len(error.strip().splitlines()) == 1
    assert words in error


def test_a_policy_of_another_model_is_not_certified(command, broken_folder):
    status, _, error = command(broken_folder)
    assert status == 2
    assert "was trained for another model" in error


def test_a_folder_that_is_no_policy_gets_one_line(command, tmp_path):
    """The same one as from any other command."""
    nowhere = tmp_path / "nowhere"
    assert command(nowhere) == (2, "", f"error: {nowhere}: no such policy folder\n")
    missing = f"error: {tmp_path / 'policy.yaml'}: is missing, so {tmp_path} is no policy folder\n"
    assert command(tmp_path) == (2, "", missing)
    (tmp_path / "policy.yaml").write_text("a: [")
    status, _, error = command(tmp_path)
    assert status == 2
    assert error.endswith("; restore it or make the policy again (hybrid-sysid policy train)\n")


def test_a_certificate_that_cannot_be_kept_is_not_begun(command, broken_folder, linear_folder):
    store = broken_folder.with_name(f"{broken_folder.name}.certificate.part")
    store.touch()
    status, out, error = command(broken_folder, "--model", linear_folder, "--seconds", "0.1", "--loops", "12")
    store.unlink()
    assert (status, out) == (2, "")
    assert str(store) in error
    assert len(error.splitlines()) == 1


# The numbers


def test_the_floor_of_the_cost_is_that_of_the_sensor_s_noise(rig: Rig, linear_folder, planning_folder):
    """An error of .052 V at each of 20 samples, at 100 per V^2."""
    values = configuration.defaults("cam_beam", "controller")
    problem = configuration.mpc_problem(values, rig)
    assert check_tolerances(values, rig, problem).floor == pytest.approx(20 * 100 * 0.052**2)
    criteria = trial_of(planning_folder, linear_folder).criteria
    assert criteria.cost_floor == pytest.approx(100 * 0.052**2)
    assert list(criteria.input_error) == list(configuration.defaults("cam_beam", "estimator")["disturbance_limit"])


def test_the_loops_are_twice_the_horizon_and_of_what_the_configuration_says(rig: Rig, planning_folder, linear_folder):
    trial = trial_of(planning_folder, linear_folder, seed=1)
    assert trial.periods == 2 * trial.policy.horizon
    scenarios = [trial.scenario(loop) for loop in range(1200) if stratum_of(loop) != DISTURBED]
    volt = rig.display[0].scale
    errors = np.concatenate([each.state_errors for each in scenarios])
    np.testing.assert_allclose(errors.std(axis=0), [0.01 * volt, 0.6 * volt], rtol=0.05)
    offsets = np.concatenate([each.disturbance_errors for each in scenarios])
    assert offsets.std() == pytest.approx(0.05, rel=0.1)
    assert all(np.ptp(each.disturbance_errors) == 0.0 for each in scenarios)
    disturbances = np.concatenate([each.disturbances for each in scenarios])
    assert disturbances.std() == pytest.approx(trial.mixture.spread.disturbance[0], rel=0.1)
    inputs = np.concatenate([each.inputs for each in scenarios])
    assert -10.0 <= inputs.min() < -9.9
    assert 9.9 < inputs.max() <= 10.0
    pushes = np.concatenate([each.pushes for each in scenarios])
    assert np.mean(np.any(pushes != 0.0, axis=1)) == pytest.approx(0.05, rel=0.1)
    gains = np.array([each.plant.named["gain"] for each in scenarios]) / rig.system.named["gain"]
    assert gains.std() == pytest.approx(0.1, rel=0.1)
