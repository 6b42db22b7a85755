"""Flights of many plants under the rig's feedback, compiled with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.core.rollout import Dynamics, dynamics
from hybrid_sysid_ros.rigs.experiments import excitation
from hybrid_sysid_ros.rigs.feedback import Law, Limits, feedback_inputs, law_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

RIG = "winged_cone"
UNCERTAIN = ("mass", "inertia", "area", "chord", "density", "elevator_moment")
"""Parameters, each anywhere within its bounds."""
SETTLING = 150.0
"""Seconds in which the integrals find the true trim."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """A flight as it went, a row a period of the feedback."""

    time: Array
    """(samples,) [s]."""
    states: Array
    """(samples, states)."""
    measured: Array
    """(samples, outputs), with noise."""
    inputs: Array
    """(samples - 1, inputs), means from each sample on."""
    commands: Array
    """(samples, followed)."""

    def record(self, rig: Rig, name: str) -> Record:
        """As the rig's bags tell it."""
        assert rig.experiments.feedback is not None
        names = [rig.channel("reference", rig.system.outputs[k].name) for k in rig.experiments.feedback.followed]
        return Record(
            name=name,
            time=self.time,
            input=np.vstack([self.inputs, self.inputs[-1:]]),
            output=self.measured,
            channels=dict(zip(names, self.commands.T, strict=True)),
        )

    def since(self, seconds: float) -> Flight:
        """From a moment on."""
        first = round(seconds / (self.time[1] - self.time[0]))
        return replace(
            self,
            time=self.time[first:] - self.time[first],
            states=self.states[first:],
            measured=self.measured[first:],
            inputs=self.inputs[first:],
            commands=self.commands[first:],
        )


def plant(system: System, seed: int) -> System:
    """One with random parameters, each uniform within its bounds."""
    random = np.random.default_rng(seed)
    return with_values(system, {name: random.uniform(-1.0, 1.0) for name in UNCERTAIN})


def with_values(system: System, shares: Mapping[str, float]) -> System:
    """One with parameters at shares -1 to 1 of their bounds."""
    changes = {}
    for item in system.parameters:
        if item.name in shares:
            middle, half = 0.5 * (item.low + item.high), 0.5 * (item.high - item.low)
            changes[item.name] = float(np.clip(middle + shares[item.name] * half, item.low, item.high))
    return replace(system, **changes)


def experiment(rig: Rig, kind: str, seed: int, seconds: float) -> Array:
    """Signals of one of the rig's experiments, (samples, inputs + followed)."""
    period = _period(rig)
    times = period * np.arange(round(seconds / period) + 1, dtype=np.float64)
    return excitation(rig, kind, seed=seed, duration=seconds, times=times)


def steps(rig: Rig, levels: Mapping[str, float], seconds: float, *, begin: float = SETTLING) -> Array:
    """Signals of commands that step to levels [SI] at a moment, and of nothing else."""
    period, feedback = _period(rig), rig.experiments.feedback
    assert feedback is not None
    count, first = round((begin + seconds) / period) + 1, round(begin / period)
    signals = np.zeros((count, len(rig.actuators) + len(feedback.followed)))
    for column, output in enumerate(feedback.followed, start=len(rig.actuators)):
        signals[first:, column] = levels.get(rig.system.outputs[output].name, 0.0)
    return signals


def fly(rig: Rig, system: System, signals: Array, *, seed: int | None = None) -> Flight:
    """Fly a plant by the signals of an experiment from rest; seed: of the sensors' noise, None: there is none."""
    feedback, m = rig.experiments.feedback, len(rig.actuators)
    assert feedback is not None
    samples = len(signals)
    noise = np.zeros((samples, len(rig.sensors)))
    if seed is not None:
        sizes = np.array([sensor.noise * sensor.scale for sensor in rig.sensors])
        noise = sizes * np.random.default_rng(seed).standard_normal(noise.shape)
    functions = compiled(system)
    states, measured = np.empty((samples, len(system.states))), np.empty(noise.shape)
    inputs = np.empty((samples - 1, m))
    _fly(
        dynamics(functions.step, functions.output, system, rig.step),
        (law_of(feedback), rig.limits, np.array([item.rate * rig.step for item in rig.actuators])),
        (np.ascontiguousarray(signals[:, :m]), np.ascontiguousarray(signals[:, m:]), noise),
        round(feedback.period / rig.step),
        states,
        measured,
        inputs,
    )
    time = feedback.period * np.arange(samples, dtype=np.float64)
    return Flight(time=time, states=states, measured=measured, inputs=inputs, commands=signals[:, m:])


def _period(rig: Rig) -> float:
    assert rig.experiments.feedback is not None
    return rig.experiments.feedback.period


@kernel
def _fly(
    system: Dynamics,
    driver: tuple[Law, Limits, Array],
    signals: tuple[Array, Array, Array],
    every: int,
    states: Array,
    measured: Array,
    inputs: Array,
) -> None:
    """As the simulated rig does it, without delays: the feedback answers each sample, the actuators follow it."""
    step, output, p, w, h, _ = system
    law, limits, most = driver
    added, commands, noise = signals
    model, integrals = np.zeros((commands.shape[1], 2)), np.zeros(inputs.shape[1])
    x, following = np.zeros(states.shape[1]), np.zeros(states.shape[1])
    u, acting, y = np.zeros(inputs.shape[1]), np.zeros(inputs.shape[1]), np.empty(measured.shape[1])
    for sample in range(states.shape[0]):
        call_value(output, x, acting, p, w, h, 0.0, y)
        for i in range(y.shape[0]):
            y[i] += noise[sample, i]
        states[sample] = x
        measured[sample] = y
        if sample == inputs.shape[0]:
            break
        feedback_inputs(law, limits, y, commands[sample], added[sample], model, integrals, u)
        inputs[sample] = 0.0
        for _ in range(every):
            for j in range(u.shape[0]):
                acting[j] = min(max(u[j], acting[j] - most[j]), acting[j] + most[j])
                inputs[sample, j] += acting[j] / every
            call_value(step, x, acting, p, w, h, 0.0, following)
            x, following = following, x
