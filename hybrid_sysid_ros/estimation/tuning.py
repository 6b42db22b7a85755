"""What an estimator is told about the sensor and about what the model does not know."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Channel:
    """A further sensor. state: index of the one it measures; noise: deviation of a measurement [unit of the state]."""

    state: int
    noise: float


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """measurement_noise: deviation of one measurement without hum [output unit]. process_noise: deviation of each state
    after one second [state unit / sqrt(s)], velocities dominate. disturbance_noise: the same of the input disturbance
    [drive unit / sqrt(s)], disturbance_limit: its bound. hum_hertz, hum_amplitude: a sine of known frequency in the
    sensor [Hz, output unit], 0 for none; hum_noise: its drift [output unit / sqrt(s)]. gate: largest normalised squared
    innovation of a measurement that is believed. patience: outliers in a row after which the measurement wins.

    input_noise: white noise of the input [drive unit sqrt(s)]: what the model does not know about forces, and friction
    swallows at rest. followed: parameters of the equation that change slowly, name -> deviation after one second [its
    unit / sqrt(s)]; each stays within its bounds. channels: further sensors by name. window: age [s] up to which a
    measurement that comes after newer ones is still used. horizon: measurements that a moving-horizon estimator looks
    back over, in place of the window.
    """

    measurement_noise: float
    process_noise: tuple[float, ...]
    disturbance_noise: float
    disturbance_limit: float
    hum_hertz: float
    hum_amplitude: float
    hum_noise: float
    gate: float
    patience: int
    input_noise: float = 0.0
    followed: Mapping[str, float] = field(default_factory=dict)
    channels: Mapping[str, Channel] = field(default_factory=dict)
    window: float = 0.2
    horizon: int = 20

    def check(self, system: System) -> None:
        """Raise UserError where an estimator of the equation can't be made from these numbers."""
        name, states = type(system).__name__, len(system.states)
        if len(system.outputs) != 1 or len(system.inputs) != 1:
            raise UserError(f"{name}: the filter takes one input and one output")
        if len(self.process_noise) != states:
            raise UserError(f"process_noise has {len(self.process_noise)} entries; the model has {states} states")
        if not (math.isfinite(self.measurement_noise) and self.measurement_noise > 0.0):
            raise UserError(f"measurement_noise is {self.measurement_noise:g}: it must be above 0")
        if not (math.isfinite(self.input_noise) and self.input_noise >= 0.0):
            raise UserError(f"input_noise is {self.input_noise:g}: it must be 0 at least")
        if self.horizon < 1 or not 0.0 <= self.window < math.inf:
            raise UserError(f"horizon is {self.horizon}, window {self.window:g} s: one measurement, 0 s at least")
        known = {item.name: item for item in system.parameters}
        for parameter, drift in self.followed.items():
            if parameter not in known:
                raise UserError(f"{name} has no parameter {parameter} to follow: it has {', '.join(known)}")
            if known[parameter].fixed or parameter == "input_delay":
                raise UserError(f"{name}: parameter {parameter} can't be followed: take another one")
            if not (math.isfinite(drift) and drift > 0.0):
                raise UserError(f"parameter {parameter} is to drift by {drift:g} a root of a second: give more than 0")
        for label, channel in self.channels.items():
            if not 0 <= channel.state < states:
                raise UserError(f"channel {label} is of state {channel.state}; the model has {states}, from 0")
            if not (math.isfinite(channel.noise) and channel.noise > 0.0):
                raise UserError(f"channel {label}: noise is {channel.noise:g}: it must be above 0")
