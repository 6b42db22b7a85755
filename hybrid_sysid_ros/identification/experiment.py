"""A record that is resampled for simulation: inputs at the simulation's step, outputs at the scored samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.models.sampling import InputHandling, Sampling, is_multiple
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

__all__ = ["PreparedRecord", "ResampledRecord", "check_range", "prepare", "rates", "resample"]
SMOOTHING_SECONDS = 0.051
"""Window of the Savitzky-Golay velocity (order 3): 51 samples at 1 kHz, and of faster records no more samples, unless
the period between scored samples is longer."""
SMOOTHING_SAMPLES = 51
RESTS, HIGH, POWER, JUMPS = 0.1, 0.8, 0.01, 6.0
"""Of a band-limited input: most samples that equal the one before, share of the Nyquist frequency above which it has
less than a share of its power, and most excess kurtosis of its changes, which is that of jumps.
"""
LINE, BESIDE = 20.0, (3, 13)
"""Power of a line, in the median of those so many lines beside it, which noise has in one of a million."""
RESONANT = 4.0
"""Most of the power of an output's line that an input's line explains, in what the whole input's power would."""
LEAST_NOISE = 1e-4
"""In the output's deviation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResampledRecord:
    """A record on the grid of a simulation, from which the states of any system can be computed."""

    name: str
    sampling: Sampling
    inputs: Array
    """Mean inputs over each step, (steps, inputs)."""
    outputs: Array
    """Raw outputs at the scored samples, (samples, outputs)."""
    rates: Array
    """Savitzky-Golay rates of the outputs at these samples, (samples, outputs)."""
    means: Array
    """Mean inputs from each sample to the next, the last one twice, (samples, inputs)."""
    measured: NDArray[np.bool_] | None
    """Which samples were measured, (samples,); None for all."""
    alias: Array
    """Offset of the outputs at the scored samples by a hum whose periods fit in between, (outputs,)."""
    noise: Array
    """Noise of the outputs, rms about a smooth curve, (outputs,)."""
    rate_noise: Array
    """Standard deviations of the rates at the first sample, (outputs,)."""

    bends: Array | None = None
    """What lines through the inputs' samples of the same means would add, (steps, inputs); None where samples hold."""
    lag: Array | None = None
    """Age of the outputs' readings [s], (outputs,)."""
    windows: Array | None = None
    """Windows over which these are means [s], (outputs,)."""

    def experiment(self, system: System) -> PreparedRecord:
        """The record with the states of a system. Raises UserError where its channels don't fit the system."""
        _check_channels(self.name, self.inputs, self.outputs, system)
        known = system.record_map()
        states = known.states_from_record(self.outputs, self.rates, self.means)
        deviations = np.ones(len(system.states))
        for state, (column, rate) in known.reconstructible.items():
            deviations[state] = (self.rate_noise if rate else self.noise)[column]
        if system.sensing is not None:
            given = known.reconstructible, self.outputs, self.rates, self.sampling.period
            for state, more in system.sensing.start_deviations(*given).items():
                deviations[state] = np.hypot(deviations[state], more)
        return PreparedRecord(
            name=self.name,
            sampling=self.sampling,
            inputs=self.inputs,
            outputs=self.outputs,
            states=states,
            measured=self.measured,
            noise=self.noise,
            alias=self.alias,
            lag=self.lag,
            windows=self.windows,
            bends=self.bends,
            deviations=deviations,
        )


def prepare(record: Record, system: System, sampling: Sampling) -> PreparedRecord:
    """Resample a record for a system.

    Raises UserError where its channels don't fit the system, it is too short, or its rate does not fit the sampling.
    """
    _check_channels(record.name, record.input, record.output, system)
    return resample(record, sampling).experiment(system)


def resample(record: Record, sampling: Sampling) -> ResampledRecord:
    """Resample a record. Raises UserError where it is too short, or its rate does not fit the sampling."""
    period = record.sampling_time
    sampled = "the record's sampling time"
    every = _ratio(sampling.period, period, record.name, "the scored period", sampled)
    samples = (len(record.time) - 1) // every + 1
    if samples < 10:
        raise UserError(
            f"{record.name}: {record.time[-1]:.2f} s are too short: at least {9 * sampling.period:.2f} s are needed"
        )
    used, handling, bends = (samples - 1) * every, sampling.input, None
    if handling == "auto":
        handling = handling_of([record], sampling)
    between = np.concatenate([record.input[1 : used + 1], record.input[-1:]])[:used]
    if handling == "sampled":
        inputs = np.repeat(record.input[:used:every], sampling.every, axis=0)
    elif handling == "interpolated" and sampling.step < period * (1 - 1e-9):
        times = _ratio(period, sampling.step, record.name, sampled, "the integration step")
        share = ((np.arange(times) + 0.5) / times)[:, None]
        inputs = np.concatenate([a + share * (b - a) for a, b in zip(record.input[:used], between, strict=True)])
    elif sampling.step >= period * (1 - 1e-9):
        block = _ratio(sampling.step, period, record.name, "the integration step", sampled)
        values = record.input[:used] if handling == "averaged" else 0.5 * (record.input[:used] + between)
        inputs = values.reshape(-1, block, record.input.shape[1]).mean(axis=1)
    else:
        times = _ratio(period, sampling.step, record.name, sampled, "the integration step")
        inputs = np.repeat(record.input[:used], times, axis=0)
        bends = _bends(record.input[: used + 1], times) if handling == "averaged" else None
    means = inputs.reshape(samples - 1, sampling.every, -1).mean(axis=1)
    found, noise = rates(record, sampling.period), noise_of(record, sampling.period)
    return ResampledRecord(
        name=record.name,
        sampling=sampling,
        inputs=np.ascontiguousarray(inputs),
        outputs=np.ascontiguousarray(record.output[::every][:samples]),
        rates=found[::every][:samples],
        means=np.concatenate([means, means[-1:]]),
        measured=None if record.measured is None else record.measured[::every][:samples],
        bends=bends,
        alias=_alias(record.output[: used + 1], record.input[: used + 1], every),
        noise=noise,
        rate_noise=_rate_noise(record, sampling.period, found, noise),
    )


def handling_of(records: Sequence[Record], sampling: Sampling) -> InputHandling:
    """How records show their inputs: "interpolated" where all are band-limited and no finer than the step, so that a
    line joins their samples better than a step does; else "averaged".
    """
    coarse = all(record.sampling_time > (1 - 1e-9) * sampling.step for record in records)
    smooth = all(_band_limited(column) for record in records for column in record.input.T)
    return "interpolated" if coarse and smooth else "averaged"


def _band_limited(values: Array) -> bool:
    """Whether an input (samples,) has next to no power near the Nyquist frequency, and neither jumps nor rests."""
    changes = np.diff(values)
    if len(values) < 64 or np.mean(changes == 0.0) > RESTS:
        return False
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))) ** 2
    return bool(
        np.sum(power[round(HIGH * len(power)) :]) < POWER * np.sum(power) and scipy.stats.kurtosis(changes) < JUMPS
    )


def _bends(inputs: Array, times: int) -> Array | None:
    """What lines of the same means would add in ``times`` steps of each sample, (steps, inputs), where inputs (samples,
    inputs) are band-limited: a record of means does not say whether such an input was held.
    """
    smooth = np.array([_band_limited(column) for column in inputs.T])
    if times == 1 or not smooth.any():
        return None
    places = (np.arange(times) + 0.5) / times - 0.5
    slopes = np.where(smooth, np.gradient(inputs, axis=0)[:-1], 0.0)
    return np.asarray((slopes[:, None] * places[:, None]).reshape(-1, inputs.shape[1]))


def _check_channels(name: str, inputs: Array, outputs: Array, system: System) -> None:
    channels, needed = (inputs.shape[1], outputs.shape[1]), (len(system.inputs), len(system.outputs))
    if channels != needed:
        raise UserError(
            f"{name}: {channels[0]} inputs and {channels[1]} outputs, but the model has {needed[0]} and "
            f"{needed[1]}; check the signals of the rig"
        )


def check_range(experiment: PreparedRecord, system: System) -> None:
    """Raise UserError for an experiment in which a state or input leaves the system's range, naming it."""
    states = experiment.states
    for item, value in system.trained_on(states.min(axis=0), states.max(axis=0)).outside:
        note = f" ({item.description})" if item.description else ""
        raise UserError(
            f"{experiment.name}: {item.name} would be {value:.6g} {item.unit}{note}, outside of "
            f"[{item.low:.6g}, {item.high:.6g}]; its unit or scale is probably wrong: convert it, or set the scale "
            "of the signals (--signals), which all records of a command share"
        )


def rates(record: Record, period: float = SMOOTHING_SECONDS) -> Array:
    """Rates of change of the outputs (samples, outputs) by Savitzky-Golay of order 3. period: of scored samples."""
    window = _window(record, period)
    return np.asarray(scipy.signal.savgol_filter(record.output, window, 3, deriv=1, delta=record.sampling_time, axis=0))


def noise_of(record: Record, period: float = SMOOTHING_SECONDS) -> Array:
    """Noise of the outputs, (outputs,): root mean squares about the curve whose slopes :func:`rates` are."""
    window = _window(record, period)
    left = record.output - scipy.signal.savgol_filter(record.output, window, 3, axis=0)
    share = 1.0 - scipy.signal.savgol_coeffs(window, 3)[window // 2]  # of white noise that is left
    least = LEAST_NOISE * np.std(record.output, axis=0)
    return np.asarray(np.maximum(np.sqrt(np.mean(left**2, axis=0) / share), np.maximum(least, 1e-12)))


def _alias(output: Array, inputs: Array, every: int) -> Array:
    """What a hum whose periods fit into ``every`` samples adds to outputs (samples, outputs) at each of these.

    It is the sum of the harmonics of the scored samples that are lines: LINE times above what is beside them in a
    spectrum by Hann's window, and that no line of an input (samples, inputs) explains, be it of a motion in time with
    the samples or of pulses. A feedback hands a hum on to the input, too, but that line is too small to explain it.
    """
    samples, found = len(output), np.zeros(output.shape[1])
    apart = samples / every  # of the harmonics, in lines of the spectrum
    if apart < 2 * BESIDE[1]:
        return found
    beside = np.concatenate([np.arange(*BESIDE), -np.arange(*BESIDE)])
    level = scipy.signal.detrend(output, axis=0)
    powers = [_powers(level), _powers(scipy.signal.detrend(inputs, axis=0))]
    moves = np.var(level, axis=0) / np.maximum(np.var(inputs, axis=0)[:, None], 1e-300)  # (inputs, outputs)
    for k in range(1, every // 2 + 1):
        at = min(round(k * apart), len(powers[0]) - 1)
        near = (at + beside)[at + beside < len(powers[0])]
        line, driven = (power[at] > LINE * np.median(power[near], axis=0) for power in powers)
        line &= ~(driven[:, None] & (powers[0][at] < RESONANT * moves * powers[1][at][:, None])).any(axis=0)
        if line.any():
            turn = np.exp(-2j * np.pi * k / every * np.arange(samples))
            share = 1.0 if 2 * k == every else 2.0
            found += np.where(line, share * np.mean(level * turn[:, None], axis=0).real, 0.0)
    return found


def _powers(values: Array) -> Array:
    """Powers of the lines of a spectrum by Hann's window, (lines, columns)."""
    return np.asarray(np.abs(np.fft.rfft(np.hanning(len(values) + 1)[:-1, None] * values, axis=0)) ** 2)


def _rate_noise(record: Record, period: float, found: Array, noise: Array) -> Array:
    """Standard deviations (outputs,) of rates at a record's first sample: of noise, and of the cubic, which is not the
    motion, as smoothing twice as long shows it.
    """
    window, samples = _window(record, period), record.samples
    edge = np.linalg.norm(scipy.signal.savgol_coeffs(window, 3, deriv=1, delta=record.sampling_time, pos=0))
    longer = min(2 * window - 1, (samples - 1) // 2 * 2 - 1)
    other = scipy.signal.savgol_filter(record.output, longer, 3, deriv=1, delta=record.sampling_time, axis=0)
    return np.asarray(np.hypot(noise * edge, np.sqrt(np.mean((found - other) ** 2, axis=0))))


def _window(record: Record, period: float) -> int:
    """Samples of the smoothing. Raises UserError for a record that is shorter."""
    seconds = min(SMOOTHING_SECONDS, max(period, SMOOTHING_SAMPLES * record.sampling_time))
    window = max(5, round(seconds / record.sampling_time) // 2 * 2 + 1)
    if len(record.time) <= window:
        raise UserError(f"{record.name}: {len(record.time)} samples are fewer than the {window} that a velocity needs")
    return window


def _ratio(longer: float, shorter: float, name: str, one: str, other: str) -> int:
    ratio = round(longer / shorter)
    if not is_multiple(longer, shorter):
        raise UserError(
            f"{name}: {one} of {longer * 1e3:g} ms is no multiple of {shorter * 1e3:g} ms, {other}; "
            "fit the model with a step and period that are (--step, --period; sampling in Python), or sample the "
            "record otherwise" + ("; is its time in seconds?" if ratio < 1 else "")
        )
    return ratio
