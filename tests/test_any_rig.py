"""A rig of three states, two inputs and two outputs, of which one is no state, and a pressure that no sensor shows."""

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hybrid_sysid_ros import models
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import one_step, rollouts
from hybrid_sysid_ros.core.symbolic import symbolic_step
from hybrid_sysid_ros.extensions.shared.horizons import k_step_errors
from hybrid_sysid_ros.extensions.shared.residual_tests import independence
from hybrid_sysid_ros.identification import evaluate, identify, prepare
from hybrid_sysid_ros.identification.fitting import fit
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.identification.validation.scores import free_run
from hybrid_sysid_ros.models import Sampling, build, structure_names
from hybrid_sysid_ros.rigs import outside
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError
from tests.small_systems import FlexibleJoint
from tests.structures import MOTIONS

SAMPLING = Sampling(step=0.005, period=0.05)
PRESSURES = (2.0, -1.5, 0.5)  # bar, where the records begin

ELSEWHERE = ("residual", "recurrent", "difnn", "hybrid_stribeck")
"""Structures that learn slowly and have tests of their own."""


@pytest.fixture(scope="module")
def press():
    return rigs.load(Path(__file__).parent / "press")


def simulated(system, x0, inputs, *, noise, seed, name, step=0.005):
    starts = np.array([[0, 0, len(inputs), 0]])
    _, outputs = rollouts(system, starts, np.array([x0]), inputs, step=step)
    deviation = noise * outputs.std(axis=0)
    outputs = outputs + deviation * np.random.default_rng(seed).normal(size=outputs.shape)
    return Record(name=name, time=np.arange(len(inputs)) * step, input=inputs, output=outputs)


def held(seed, sizes, *, samples=2401, hold=80):
    levels = np.random.default_rng(seed).uniform(-1.0, 1.0, (samples // hold + 1, len(sizes)))
    return np.ascontiguousarray((levels * sizes).repeat(hold, axis=0)[:samples])


@pytest.fixture(scope="module")
def records(press):
    return [
        simulated(press.system, [0.0, 0.0, p], held(seed, [5.0, 4.0]), noise=0.01, seed=seed, name=f"press {seed}")
        for seed, p in enumerate(PRESSURES)
    ]


@pytest.fixture(scope="module")
def gray(press, records):
    return identify(records, press, "gray", sampling=SAMPLING)


def test_its_parameters_come_back_within_three_standard_errors(press, gray):
    for name, error in gray.standard_errors.items():
        assert abs(gray.system.named[name] - press.system.named[name]) < 3 * error, name
        assert error < 0.3 * press.system.named[name], name
    assert gray.system.input_delays == pytest.approx([0.012, 0.0], abs=0.004)


def test_where_the_pressure_began_is_found(press, records, gray):
    experiments = [prepare(record, press.system, SAMPLING) for record in records]
    started = press.system.with_values([item.start for item in press.system.parameters])
    fitted = fit(started, experiments)
    np.testing.assert_allclose(fitted.nuisances["pressure"], PRESSURES, atol=0.1)
    for experiment, pressure in zip(experiments, PRESSURES, strict=True):
        assert initial_state(gray.system, experiment)[2] == pytest.approx(pressure, abs=0.15)


def test_scores_are_reported_for_each_output(press, records, gray):
    scores = evaluate(gray, records[0])
    assert set(scores.outputs) == {"position", "leakage"}
    assert scores.r2 == pytest.approx(np.mean([item.r2 for item in scores.outputs.values()]))
    assert all(item.r2 > 0.99 for item in scores.outputs.values())
    # The noise is a hundredth of each output's deviation.
    for k, item in enumerate(scores.outputs.values()):
        assert item.rmse == pytest.approx(0.01 * records[0].output[:, k].std(), rel=0.35)
    assert set(gray.scores["press 0"]) == {"r2", "fit_percent", "outputs"}


def test_errors_and_residuals_are_judged_for_each_output(press, records, gray):
    experiment = prepare(records[1], gray.system, SAMPLING)
    for output in (0, 1):
        curve = k_step_errors(gray.system, experiment, (1, 20, 100), output=output)
        assert np.all(curve.r2 > 0.95)
    residuals = (experiment.outputs - free_run(gray.system, experiment))[:-1]
    inputs = experiment.inputs.reshape(len(residuals), SAMPLING.every, -1).mean(axis=1)
    for signal in inputs.T:
        assert all(np.isfinite(independence(error, signal).p_value) for error in residuals.T)


@pytest.mark.parametrize(
    "structure",
    [
        pytest.param(name, marks=pytest.mark.slow if name in ELSEWHERE else ())
        for name in (*structure_names(), "hybrid_stribeck")
    ],
)
def test_every_structure_learns_it(press, records, structure, monkeypatch):
    """From one record; another was never seen. A linear system lacks the friction, others may have it."""
    pytest.importorskip("sysidentpy" if structure == "narx" else "torch" if structure == "recurrent" else "numpy")
    if structure == "recurrent":  # a linear motion, nearly: the extension's own tests train at length
        training = pytest.importorskip("hybrid_sysid_ros.extensions.recurrent.training")
        short = partial(training.train_network, schedule=training.TrainingSchedule(stages=((20, 150), (40, 150))))
        monkeypatch.setattr(training, "train_network", short)
    few = {"narx": {"degree": 1, "terms": 0, "output_lags": 3}, "difnn": {"terms": 2}}
    options = few.get(structure, {})
    model = identify(records[:1], press, structure, sampling=SAMPLING, options=options)
    scores = evaluate(model, records[2])
    assert scores.r2 > (0.8 if structure == "recurrent" else 0.9), scores
    assert [item.name for item in model.system.outputs] == ["position", "leakage"]


def test_a_model_of_a_rig_by_its_path_is_loaded_with_it_and_refused_without(press, gray, tmp_path, monkeypatch):
    gray.save(tmp_path / "model")
    back = models.load(tmp_path / "model")
    np.testing.assert_array_equal(back.system.values, gray.system.values)
    monkeypatch.delenv(outside.VARIABLE)  # as in a process that was not told of it
    with pytest.raises(UserError, match="--rig"):
        models.load(tmp_path / "model")
    assert models.load(tmp_path / "model", rig=press.folder).rig == "press"
    with pytest.raises(UserError, match="not of cam_beam"):
        models.load(tmp_path / "model", rig="cam_beam")


# ---------------------------------------------------------------------------- the flexible joint


@pytest.fixture(scope="module")
def joint(press):
    return dataclasses.replace(press, system=FlexibleJoint(), structures={}, name="joint", sensors=press.sensors[:1])


@pytest.fixture(scope="module")
def swings():
    """The link of a flexible joint, driven by steps of torque."""
    return [
        simulated(FlexibleJoint(), np.zeros(4), torque, noise=0.002, seed=seed, name=f"joint {seed}")
        for seed, torque in enumerate(held(seed, [1.5], samples=4001, hold=40) for seed in (0, 1))
    ]


@pytest.mark.parametrize(
    "structure", ["linear", "stribeck", "dahl", "lugre", pytest.param("hybrid_lugre", marks=pytest.mark.slow)]
)
def test_the_flexible_joint_is_learnt_with_every_friction(joint, swings, structure):
    """The motor is not measured. Friction that the rig has on its motor is in the model's motor, too."""
    model = identify(swings[:1], joint, structure, sampling=Sampling(step=0.005, period=0.05))
    carriers = {contact.on for contact in model.system.contacts}
    assert carriers == {"motor_speed", "link_speed"}
    least = {"linear": 0.3}.get(structure, 0.9)
    assert evaluate(model, swings[1]).r2 > least


@pytest.mark.parametrize("structure", MOTIONS)
def test_compiled_steps_of_four_states_are_the_traced_ones(structure):
    """Features beyond the second state are the states', and inputs follow the last of them."""
    random = np.random.default_rng(0)
    system, _ = build(structure, FlexibleJoint(), scales=random.uniform(0.1, 1.0, 5), seed=0)
    if len(system.weights):
        system = system.with_weights(random.normal(size=len(system.weights)))
    step = symbolic_step(system, step=0.005)
    for _ in range(20):
        x, u = random.normal(size=len(system.states)), random.normal(size=1)
        np.testing.assert_allclose(one_step(system, x, u, step=0.005), np.array(step(x, u)).ravel(), rtol=1e-9)


def test_friction_on_a_rig_without_contacts_is_refused(motor):
    for structure in ("stribeck", "dahl", "lugre"):
        with pytest.raises(UserError, match="no contact"):
            build(structure, motor, scales=np.ones(4), seed=0)
