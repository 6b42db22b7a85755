"""Tuning of an estimator: noise of the sensors, and uncertainty of the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.support.arrays import Numbers
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class SensorChannel:
    """A further sensor with stamps of its own."""

    of: str
    """Name of the output or the state that it measures."""
    noise: float
    """Standard deviation of a measurement, in its unit."""


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Vectors are in the order of the system's outputs (p), inputs (m) or states (n); one value is valid for all."""

    measurement_noise: Numbers
    """Deviation of one measurement without hum, (p,) [output unit]."""
    process_noise: Numbers
    """Deviation of each state after one second, (n,) [state unit / sqrt(s)]; velocities dominate."""
    disturbance_noise: Numbers
    """Deviation of the offset of each input after one second, (m,) [input unit / sqrt(s)]; 0: no offset."""
    disturbance_limit: Numbers
    """Limit of each estimated offset, (m,) [input unit]."""
    input_noise: Numbers = (0.0,)
    """White noise of each input, (m,) [input unit sqrt(s)]: unmodelled forces, which friction absorbs at rest."""
    hum_hertz: Numbers = (0.0,)
    """Frequency of a sine in each sensor, (p,) [Hz]; 0: none."""
    hum_amplitude: Numbers = (0.0,)
    """Amplitude of the hum in each sensor, (p,) [output unit]; 0: none."""
    hum_noise: Numbers = (0.0,)
    """Drift of the hum, (p,) [output unit / sqrt(s)]."""
    initial_deviation: Numbers = ()
    """Initial deviation of each state without a sensor, (n,) [state unit]; by default that of its process noise after
    100 s.
    """
    state_limit: Numbers = (math.inf,)
    """Largest magnitude of each state, (n,) [state unit]. The filters' estimates of it are at least as sure as that it
    may be anything within, also where no measurement has shown it for long.
    """
    gate: float = 25.0
    """Largest normalised squared innovation of a measurement that is used."""
    patience: int = 5
    """Consecutive outliers of a sensor after which the estimator is initialised from it."""
    followed: Mapping[str, float] = field(default_factory=dict)
    """Parameters of the system that change slowly: name -> deviation after one second [its unit / sqrt(s)]; each stays
    within its bounds.
    """
    channels: Mapping[str, SensorChannel] = field(default_factory=dict)
    """Further sensors by name."""
    window: float = 0.2
    """Age [s] up to which a measurement that comes after newer ones is still used."""
    horizon: int = 20
    """Number of measurements in the horizon of a moving-horizon estimator, which replaces the window."""

    def checked(self, system: System) -> Tuning:
        """A tuning with an entry for each state, input and output. Raises UserError where it doesn't fit the system."""
        if not (self.horizon >= 1 and 0.0 <= self.window < math.inf):
            raise UserError(f"horizon is {self.horizon}, window {self.window:g} s: they need at least 1 and 0 s")
        if not (self.gate > 0.0 and self.patience >= 0):
            raise UserError(f"gate is {self.gate:g}, patience {self.patience}: they need above 0, and at least 0")
        self._check_followed(system)
        self._check_channels(system)
        process = _each("process_noise", self.process_noise, system.states, "state")
        initial = self.initial_deviation or tuple(10.0 * value for value in process)
        return replace(
            self,
            measurement_noise=_each("measurement_noise", self.measurement_noise, system.outputs, "output", above=True),
            process_noise=process,
            disturbance_noise=_each("disturbance_noise", self.disturbance_noise, system.inputs, "input"),
            disturbance_limit=_each("disturbance_limit", self.disturbance_limit, system.inputs, "input"),
            input_noise=_each("input_noise", self.input_noise, system.inputs, "input"),
            hum_hertz=_each("hum_hertz", self.hum_hertz, system.outputs, "output"),
            hum_amplitude=_each("hum_amplitude", self.hum_amplitude, system.outputs, "output"),
            hum_noise=_each("hum_noise", self.hum_noise, system.outputs, "output"),
            initial_deviation=_each("initial_deviation", initial, system.states, "state"),
            state_limit=_each("state_limit", self.state_limit, system.states, "state", above=True),
        )

    def _check_followed(self, system: System) -> None:
        kind, known = type(system).__name__, {item.name: item for item in system.parameters}
        for name, drift in self.followed.items():
            if name not in known:
                raise UserError(f"{kind} has no parameter {name} to follow: it has {', '.join(known)}")
            if known[name].fixed or name in system.delays.values():
                raise UserError(f"{kind}: parameter {name} can't be followed: choose another one")
            if not (math.isfinite(drift) and drift > 0.0):
                raise UserError(f"parameter {name} drifts by {drift:g} per root of a second: give more than 0")

    def _check_channels(self, system: System) -> None:
        known = list(dict.fromkeys(item.name for item in (*system.outputs, *system.states)))
        for name, channel in self.channels.items():
            if channel.of not in known:
                raise UserError(f"channel {name} measures {channel.of}, which is none of {', '.join(known)}")
            if not (math.isfinite(channel.noise) and channel.noise > 0.0):
                raise UserError(f"channel {name}: noise is {channel.noise:g}: it must be above 0")


def _each(name: str, given: Numbers, of: Sequence[Variable], what: str, *, above: bool = False) -> Numbers:
    """A number for each variable. Raises UserError for another count, and for numbers below 0 or, ``above``, of 0."""
    values = tuple(given) * len(of) if len(given) == 1 else tuple(given)
    if len(values) != len(of):
        names = ", ".join(item.name for item in of)
        raise UserError(f"{name} has {len(values)} entries for {len(of)} {what}s: {names}; give one for each, or one")
    for item, value in zip(of, values, strict=True):
        if not (value > 0.0 if above else value >= 0.0) or (value == math.inf and not name.endswith("_limit")):
            least = "must be above 0" if above else "must be at least 0"
            raise UserError(f"{name} of {what} {item.name} is {value:g}: it {least}")
    return values
