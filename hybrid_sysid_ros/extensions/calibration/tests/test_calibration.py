"""Sensors that are fitted beside the physics, against quadrature, differences, and records of known sensors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Sensitivities, System, bounded, rollouts, simulate
from hybrid_sysid_ros.core.mathematics import Scalar, sin
from hybrid_sysid_ros.extensions.calibration.calibrated import Calibrated, Calibration, Free
from hybrid_sysid_ros.identification import evaluate, identify
from hybrid_sysid_ros.identification.validation.identifiability import doubts
from hybrid_sysid_ros.models import Model, Sampling, load
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.support.errors import UserError
from tests.linear_bench import record_of
from tests.test_input_handling import Lag

FINE, PERIOD, SAMPLES = 10, 0.01, 2000
SENSOR = {"angle_gain": 1.2, "angle_offset": -0.15, "angle_delay": 0.031, "angle_window": 0.05}
PRIORS = {"angle_gain": 0.3, "angle_offset": 0.3, "angle_delay": 0.05, "angle_window": 0.05}


@dataclass(frozen=True, kw_only=True)
class TorquePendulum(System):
    """A pendulum whose torque is known: its sine tells an angle from another scale, and its rest from an offset."""

    states = ("angle [rad]", "speed [rad/s]")
    inputs = ("torque [N m]",)

    stiffness: float = bounded(30.0, 5.0, 100.0, start=25.0, unit="1/s^2")
    damping: float = bounded(1.5, 0.0, 10.0, start=1.0, unit="1/s")

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], u[0] - self.stiffness * sin(x[0]) - self.damping * x[1]


@dataclass(frozen=True, kw_only=True)
class Twice(TorquePendulum):
    """A pendulum with a parameter that is called as one of its sensor would be."""

    angle_gain: float = bounded(1.0, 0.1, 2.0, unit="1")


def rig_of(system: System) -> rigs.Rig:
    joint = rigs.load("cam_beam")
    two = np.tile([[-np.inf], [np.inf]], 2)
    sensors = (replace(joint.sensors[0], unit="rad", scale=1.0, low_pass=None, delay=0.0),)
    return replace(joint, system=system, structures={}, travel=two, validity=None, offsets={}, sensors=sensors)


def recorded(seed: int, sensor: dict[str, float], noise: float = 0.002) -> Record:
    """Readings by quadrature of a fine run: no code of the package but its steps."""
    random = np.random.default_rng(seed)
    levels = 20.0 * random.uniform(-1.0, 1.0, SAMPLES // 40).repeat(40)
    run = simulate(TorquePendulum(), np.zeros(2), levels.repeat(FINE)[:, None], step=PERIOD / FINE)[:, 0]
    fine = np.arange(len(run)) * PERIOD / FINE
    time = np.arange(SAMPLES) * PERIOD
    ages = sensor["angle_delay"] + np.linspace(0.0, sensor["angle_window"], 201)
    angle = np.mean([np.interp(time - age, fine, run) for age in ages], axis=0)
    readings = sensor["angle_gain"] * angle + sensor["angle_offset"] + noise * random.normal(size=SAMPLES)
    return record_of(levels[:, None], readings[:, None], PERIOD)


@pytest.fixture(scope="module")
def model() -> Model:
    given = Sampling(step=0.005, period=0.02)
    return identify(
        [recorded(0, SENSOR), recorded(1, SENSOR)], rig_of(TorquePendulum()), "gray", sampling=given, options=PRIORS
    )


def test_gain_offset_delay_and_window_are_found_within_their_intervals(model: Model) -> None:
    found, errors = model.system.named, model.standard_errors
    truth = {**SENSOR, "stiffness": 30.0, "damping": 1.5}
    for name, value in truth.items():
        assert abs(found[name] - value) < 3.0 * errors[name] + 0.003 * abs(value), name
        assert errors[name] < 0.1 * PRIORS.get(name, 30.0), name
    assert min(scores["r2"] for scores in model.scores.values()) > 0.999


def test_a_saved_model_keeps_its_sensors(model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model.save(tmp_path / "model")
    rig = rig_of(TorquePendulum())
    monkeypatch.setattr(rigs, "load", lambda *_: rig)
    again = load(tmp_path / "model")
    assert again.system.named == model.system.named
    record = recorded(2, SENSOR)
    assert evaluate(again, record).r2 == evaluate(model, record).r2 > 0.999


def test_a_gain_that_no_record_tells_from_the_physics_is_doubted() -> None:
    """Of a linear law the scale of the input and that of the sensor are one number."""
    random = np.random.default_rng(0)
    levels = 20.0 * random.uniform(-1.0, 1.0, SAMPLES // 40).repeat(40)[:, None]
    speed = simulate(Lag(), np.zeros(1), levels, step=PERIOD)[:-1]
    record = record_of(levels, speed + 0.01 * random.normal(size=speed.shape), PERIOD)
    rig = replace(rigs.load("wheel_motor"), system=Lag(), structures={})
    model = identify([record], rig, "gray", sampling=Sampling(step=0.01, period=0.01), options={"speed_gain": 0.1})
    reasons = {item.parameter.name: str(item) for item in doubts(model)}
    assert "hardly known better than before" in reasons["speed_gain"]
    assert "can't be told apart from speed_gain (-1.00)" in reasons["gain"]
    assert model.system.named["gain"] * model.system.named["speed_gain"] == pytest.approx(0.15, rel=0.01)


def test_readings_have_the_derivatives_of_their_differences() -> None:
    free = tuple(Free(output="angle", quantity=name, centre=0.1, spread=0.1) for name in ("gain", "delay", "window"))
    system = Calibrated(physics=TorquePendulum(), free=free, numbers=(1.1, 0.0133, 0.0312), lags=((0.0, 0.0),))
    inputs = np.random.default_rng(0).normal(size=(400, 1)).cumsum(axis=0)
    starts, first = np.array([[0, 0, 41, 0], [0, 100, 30, 41]]), np.array([[0.3, 0.0], [0.2, 1.0]])
    given: dict[str, Any] = {"step": 0.005, "every": 5}
    sensitivities = Sensitivities(system)
    found = np.empty((71, 1, sensitivities.count))
    sensitivities.rollouts(system, starts, first, inputs, **given, out=found)
    for column, index in enumerate(sensitivities.parameters):
        sides = []
        for side in (-1e-7, 1e-7):
            values = system.values
            values[index] += side
            sides.append(rollouts(system.with_values(values), starts, first, inputs, **given)[1][:, 0])
        np.testing.assert_allclose(found[:, 0, column], (sides[1] - sides[0]) / 2e-7, atol=1e-5)


def test_a_loop_has_what_all_readings_are_late_by_as_a_delay_of_its_inputs() -> None:
    free = tuple(Free(output="angle", quantity=name, centre=0.1, spread=0.1) for name in ("delay", "window"))
    system = Calibrated(physics=TorquePendulum(), free=free, numbers=(0.02, 0.01), lags=((0.0, 0.0),))
    np.testing.assert_allclose(system.input_delays, [0.025])
    assert system.plain_outputs


def test_sensors_that_can_not_be_are_refused() -> None:
    record, rig = recorded(0, SENSOR), rig_of(TorquePendulum())
    sampling = Sampling(step=0.005, period=0.02)
    with pytest.raises(UserError, match=r"has no option speed_gain; it has .*angle_gain"):
        identify([record], rig, "gray", sampling=sampling, options={"speed_gain": 0.1})
    with pytest.raises(UserError, match="angle_delay = -1 is outside"):
        identify([record], rig, "gray", sampling=sampling, options={"angle_delay": -1.0})
    free = (Free(output="angle", quantity="gain", centre=1.0, spread=0.1),)
    with pytest.raises(UserError, match="parameter of that name; rename it"):
        Calibrated(physics=Twice(), free=free, numbers=(1.0,), lags=((0.0, 0.0),))
    for design in (
        {"sensors": [["speed", "gain", 1.0, 0.1]], "lags": [[0, 0]]},
        {"sensors": [["angle", "hum", 1, 1]], "lags": [[0, 0]]},
    ):
        with pytest.raises(UserError, match="fit again"):
            Calibration().stored(TorquePendulum(), design)
