"""How a fit takes its inputs where the records' samples alone do not say it: held, or joined by lines."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from hybrid_sysid_ros.core import System, bounded, simulate
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.identification.experiment import resample
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import load
from tests.linear_bench import record_of

PERIOD, FINE, SAMPLES = 0.01, 20, 1200


@dataclass(frozen=True, kw_only=True)
class Lag(System):
    """A motor as a lag, without a delay that could pass for half a sample."""

    states = ("speed [rad/s]",)
    inputs = ("pwm [counts]",)

    gain: float = bounded(0.15, 0.01, 1.0, start=0.1, unit="rad/s/counts")
    rate: float = bounded(20.0, 1.0, 100.0, start=10.0, unit="1/s")

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return (self.rate * (self.gain * u[0] - x[0]),)


@pytest.mark.parametrize("handling", ["averaged", "interpolated"])
def test_the_training_error_says_whether_a_smooth_input_was_held(handling):
    """The samples are those of the same band-limited signal both times; what acted between them differs."""
    time = np.arange(SAMPLES) * PERIOD
    samples = sum(20.0 * np.sin(2 * np.pi * f * time + f * f) for f in (0.5, 2.0, 5.0, 11.0, 17.0))
    share = np.arange(FINE) / FINE
    between = samples[:-1, None] + (share * np.diff(samples)[:, None] if handling == "interpolated" else 0.0 * share)
    speed = simulate(Lag(), np.zeros(1), between.reshape(-1, 1), step=PERIOD / FINE)[::FINE]
    record = record_of(samples[:, None], speed + 0.01 * np.random.default_rng(0).normal(size=speed.shape), PERIOD)
    rig = replace(load("wheel_motor"), system=Lag(), structures={})
    model = identify([record], rig, "gray", sampling=Sampling(step=0.01, period=0.01, input="auto"), refine=True)
    assert model.sampling.input == handling
    assert model.system.named["gain"] == pytest.approx(0.15, rel=0.01)
    assert model.system.named["rate"] == pytest.approx(20.0, rel=0.05)
    tried = model.fit["inputs_tried"]
    assert min(tried, key=tried.get) == handling
    assert f"training errors: averaged {100 * tried['averaged']:.3g} %" in model.inputs_sentence


def test_a_record_of_means_leaves_open_whether_its_input_was_held():
    """Standard errors hold the truth where a smooth input went on moving between samples that are its means."""
    fine = np.arange(SAMPLES * FINE) * PERIOD / FINE
    waves = [20.0 * np.sin(2 * np.pi * f * fine + f * f) for f in (0.5, 2.0, 5.0, 7.0)]
    moving = np.sum(waves, axis=0)
    means = moving.reshape(-1, FINE).mean(axis=1)
    speed = simulate(Lag(), np.zeros(1), moving[:, None], step=PERIOD / FINE)[::FINE]
    record = record_of(means[:, None], speed[:SAMPLES], PERIOD)
    step = PERIOD / 5
    bends = resample(record, Sampling(step=step, period=PERIOD, input="averaged")).bends
    assert bends is not None
    assert np.mean(bends.reshape(-1, 5), axis=1) == pytest.approx(0.0, abs=1e-12)
    about = np.repeat(means[:-1], 5) + bends[:, 0] - moving[:-FINE].reshape(-1, 4).mean(axis=1)
    assert float(np.std(about[50:-50])) < 0.1 * np.std(bends)
    rig = replace(load("wheel_motor"), system=Lag(), structures={})
    model = identify([record], rig, "gray", sampling=Sampling(step=step, period=PERIOD, input="averaged"))
    for name, error in model.standard_errors.items():
        assert abs(model.system.named[name] - Lag().named[name]) < 1.645 * error, name
