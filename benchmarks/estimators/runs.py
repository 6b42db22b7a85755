"""Runs for the benchmark of the estimators: what was measured, what was applied, and what was true."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import one_step
from hybrid_sysid_ros.estimation import Tuning
from hybrid_sysid_ros.rigs.excitation import multisine, random_steps
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

PERIOD = 0.005
"""Of the measurements [s]."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """measured (samples,) [rad]; inputs (samples,): the mean drive since the sample before [V]; states (samples, 2):
    the true ones [rad, rad/s].
    """

    measured: Array
    inputs: Array
    states: Array

    def __iter__(self) -> Iterator[tuple[float, Array, Array]]:
        """What an estimator is told: time, output (1,), applied (1,)."""
        for k in range(len(self.measured)):
            yield k * PERIOD, self.measured[k : k + 1], self.inputs[k : k + 1]


def beam(
    rig: Rig,
    seed: int,
    *,
    seconds: float,
    bias: float = 0.0,
    changes: Mapping[float, Mapping[str, float]] | None = None,
) -> Run:
    """The simulated beam under its own P controller: the sensor's hum, noise and counts, an input that is off by
    ``bias`` [V]. Multisines and random steps take turns over the seeds.

    changes: time [s] -> parameters of the rig's equation that jump to new values there.
    """
    plant, gain, actuator = Plant(rig, seed=seed, bias=bias), rig.experiments.loops[0].gain, rig.actuators[0]
    reference = multisine(seed, amplitude=4.0, low=0.1, high=1.5, lines=15, period=10.0)
    if seed % 2:
        reference = random_steps(seed, amplitude=4.0, hold=1.0, duration=seconds)
    samples, steps = round(seconds / PERIOD), round(PERIOD / rig.step)
    measured, inputs, states = np.empty(samples), np.empty(samples), np.empty((samples, 2))
    due = {round(time / PERIOD): values for time, values in (changes or {}).items()}
    drive = 0.0
    for k in range(samples):
        if k in due:
            plant.change(**due[k])
        shown = plant.measure()
        measured[k], inputs[k], states[k] = shown.outputs[0], drive, plant.state
        error = float(reference(k * PERIOD)) - shown.filtered[0] / rig.display[0].scale
        drive = float(np.clip(gain * error, actuator.low, actuator.high))
        for _ in range(steps):
            plant.advance(drive)
    return Run(measured=measured, inputs=inputs, states=states)


def drawn(system: System, tuning: Tuning, seed: int, *, samples: int) -> Run:
    """A plant that is the model, with the start, the noise and the disturbance that the tuning says, drawn afresh."""
    random = np.random.default_rng(seed)
    drift = np.array([*tuning.process_noise, *tuning.disturbance_noise, *tuning.hum_noise, *tuning.hum_noise])
    start = 10.0 * drift
    start[0], start[3:] = 0.0, tuning.hum_amplitude[0]
    z = start * random.normal(size=5)
    z[2] = np.clip(z[2], -tuning.disturbance_limit[0], tuning.disturbance_limit[0])
    levels = np.repeat(random.uniform(-6.0, 8.0, samples // 40 + 1), 40)[:samples]
    past = np.concatenate([np.full(20, levels[0]), levels])  # levels[k] acts from sample k - 1 to k, a delay later
    whole, part = divmod(system.delay / PERIOD, 1.0)
    angle = 2.0 * np.pi * tuning.hum_hertz[0] * PERIOD
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    measured, states = np.empty(samples), np.empty((samples, 2))
    for k in range(samples):
        if k:
            at = k + 20 - int(whole)
            force = tuning.input_noise[0] / np.sqrt(PERIOD) * random.normal()
            drive = (1.0 - part) * past[at] + part * past[at - 1] + z[2] + force
            following = one_step(system, z[:2], np.array([drive]), step=PERIOD)
            z = np.array([*following, z[2], *(turn @ z[3:])]) + np.sqrt(PERIOD) * drift * random.normal(size=5)
        measured[k] = z[0] + z[3] + tuning.measurement_noise[0] * random.normal()
        states[k] = z[:2]
    return Run(measured=measured, inputs=levels, states=states)
