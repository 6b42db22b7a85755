"""Fits with a constant bias of each record's inputs beside the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from hybrid_sysid_ros.core import Bristles, Sensitivities, System, bounded, rollouts
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.identification import PreparedRecord
from hybrid_sysid_ros.identification.fitting import Biased, fit
from hybrid_sysid_ros.models import Sampling

SAMPLING = Sampling(step=0.005, period=0.01)
BIASES = np.array([0.3, -0.2, 0.1])
SPREAD = 0.5


@dataclass(frozen=True, kw_only=True)
class WindySled(System):
    """x'' = g u + h w - k x on bristles: a drive, a wind, and what both together do to a gauge."""

    states = ("place [m]", "speed [m/s]")
    inputs = ("drive [N]", "wind [N]")
    outputs = ("place", "gauge [N]")
    contacts = (Bristles(on="speed", level=1.0, stiffness="bristles", damping=2.0, viscous=0.5),)

    gain: float = bounded(2.0, 0.1, 10.0, start=1.0, unit="1/kg")
    stiffness: float = bounded(9.0, 0.1, 50.0, start=6.0, unit="1/s^2")
    bristles: float = bounded(300.0, 10.0, 1000.0, start=200.0, unit="1/s^2")

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], self.gain * u[0] + 0.5 * u[1] - self.stiffness * x[0]

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[0], u[0] - u[1]


def inputs(seed: int, steps: int = 1200) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-4.0, 4.0, (steps // 60, 2)).repeat(60, axis=0)


def along(system: System, drive: np.ndarray, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rollouts(system, np.array([[0, 0, len(drive) + 1, 0]]), begin[None], drive, step=SAMPLING.step)


def test_it_is_the_system_under_the_inputs_with_their_biases():
    """States, deflection and outputs, for b in units of its spreads."""
    biased, drive, b = Biased(physics=WindySled(), spreads=(0.5, 0.2)), inputs(0), np.array([0.6, -1.5])
    states, outputs = along(biased, drive, np.array([0.1, 0.2, *b, 0.001]))
    expected, shown = along(WindySled(), drive + b * [0.5, 0.2], np.array([0.1, 0.2, 0.001]))
    np.testing.assert_allclose(states[:, [0, 1, 4]], expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(outputs, shown, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(states[:, 2:4], np.broadcast_to(b, (len(states), 2)))
    assert [item.name for item in biased.states] == ["place", "speed", "bias_drive", "bias_wind", "deflection"]


def test_its_slopes_are_what_simulations_differ_by():
    biased, drive, begin = Biased(physics=WindySled(), spreads=(0.5, 0.2)), inputs(1, 120), np.zeros(5)
    sensitivities = Sensitivities(biased, parameters=(), states=[2, 3])
    jacobian, starts = np.empty((121, 2, sensitivities.count)), np.array([[0, 0, 121, 0]])
    sensitivities.rollouts(biased, starts, begin[None], drive, step=SAMPLING.step, every=1, out=jacobian)
    for column, state in enumerate((2, 3)):
        moved = 1e-6 * np.eye(5)[state]
        above, below = (along(biased, drive, begin + sign * moved)[1] for sign in (1.0, -1.0))
        np.testing.assert_allclose(jacobian[:, :, column], (above - below) / 2e-6, rtol=1e-4, atol=1e-7)


def records() -> list[PreparedRecord]:
    """Of the sled, whose drive is off by another constant in each, while its wind is known."""
    found = []
    for seed, bias in enumerate(BIASES):
        drive = inputs(seed, 3000)
        states, outputs = along(WindySled(), drive + np.array([bias, 0.0]), np.zeros(3))
        shown = np.zeros((1501, 3))
        shown[:, :2] = states[::2, :2]
        noise = np.random.default_rng(seed).normal(size=(1501, 2)) * [1e-4, 1e-2]
        measured = outputs[::2] + noise
        found.append(PreparedRecord(name=f"{seed}", sampling=SAMPLING, inputs=drive, outputs=measured, states=shown))
    return found


def test_biases_and_parameters_come_back_where_a_plain_fit_errs():
    reported = records()
    start = WindySled(gain=1.0, stiffness=6.0, bristles=200.0)
    plain = fit(start, reported)
    biased = Biased(physics=start, spreads=(SPREAD, 0.0))
    beside = [replace(item, states=np.insert(item.states, 2, np.zeros((2, 1)), axis=1)) for item in reported]
    fitted = fit(biased, beside)
    found = biased.biases(fitted.nuisances)
    np.testing.assert_allclose(found["drive"], BIASES, atol=5e-3)
    np.testing.assert_array_equal(found["wind"], 0.0)
    errors = [np.abs(item.system.values / WindySled().values - 1.0).max() for item in (plain, fitted)]
    assert errors[1] < 5e-3
    assert errors[0] > 5.0 * errors[1]


def test_a_prior_without_width_leaves_no_bias():
    reported = records()[:1]
    beside = [replace(item, states=np.insert(item.states, 2, np.zeros((2, 1)), axis=1)) for item in reported]
    biased = Biased(physics=WindySled(), spreads=(1e-9, 1e-9))
    found = biased.biases(fit(biased, beside).nuisances)
    assert found["drive"][0] == pytest.approx(0.0, abs=1e-7)
