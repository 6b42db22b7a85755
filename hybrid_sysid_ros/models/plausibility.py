"""Plausibility: values in a record that its rig can hardly have had."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.models.model import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError, counted

PASSED = 0.5
"""Share of an actuator's span by which a measured input may exceed it, by noise or by a limit that is not exact."""
AROUND = 7
"""Samples in the median from which a spike is far away; a spike has at most three samples."""
MIDDLE, SPAN = (2.0, 98.0), 0.75
"""A spike is farther from the samples around it than a share of the range. The range is that of the medians, or between
these percentiles where that is larger: medians of an oscillation near the Nyquist frequency are too small.
"""
FARTHER = 5.0
"""Ratio to the training range above which the unit is doubted: rpm for rad/s give 9.5, degrees for radians 57."""


SLOWER = 300.0
"""Times of a record in the rig's step, from which its unit of time is doubted: ms that are taken for s make 1000."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordChannel:
    """An input or output of a record, and its origin."""

    what: str
    """Bag, topic and field."""
    variable: Variable
    period: float
    values: Array
    """(samples,)."""

    def at(self, sample: int) -> str:
        """A sample in words, for messages."""
        return f"sample {sample} ({sample * self.period:.6g} s)"


def check_limits(record: Record, rig: Rig, signals: Signals | None = None) -> None:
    """Raise UserError for an input that the rig's actuator can't give. signals: those of the record in the order of the
    rig's inputs; None for a record from arrays.
    """
    remedy = "set the scale of the signals (--signals), repair the driver" if signals else "convert its unit"
    for channel, low, high in zip(_inputs(record, rig, signals), *rig.limits, strict=True):
        margin = PASSED * (high - low)
        beyond = np.flatnonzero((channel.values < low - margin) | (channel.values > high + margin))
        if len(beyond):
            unit, farthest = channel.variable.unit, channel.values[_farthest(channel.values, beyond)]
            raise UserError(
                f"{channel.what}: input {channel.variable.name} goes to {farthest:.6g} {unit}, and the rig's actuator "
                f"from {low:g} to {high:g} {unit} only: {len(beyond)} of {record.samples} samples are far beyond, the "
                f"first at {channel.at(int(beyond[0]))}; {remedy}, or correct "
                f"actuators in {rig.file}"
            )


def check_travel(record: Record, rig: Rig) -> None:
    """Raise UserError for an output far beyond the stops of the rig, which is probably in another unit."""
    for channel, low, high in zip(_outputs(record, rig, None), *rig.travel_of_outputs, strict=True):
        margin = PASSED * (high - low)
        farthest = float(channel.values[np.argmax(np.abs(channel.values))])
        if not low - margin <= farthest <= high + margin:
            unit = channel.variable.unit
            raise UserError(
                f"{channel.what}: output {channel.variable.name} goes to {farthest:.6g}, and the rig's travel from "
                f"{low:g} to {high:g} {unit} only: is it in {unit}? convert it, or correct travel in {rig.file}"
            )


def spikes(record: Record, rig: Rig, signals: Signals | None = None) -> list[str]:
    """Lines on outputs with spikes: samples that differ from their neighbours by as much as the rest of the record."""
    found = []
    for channel in _outputs(record, rig, signals) if record.samples >= AROUND else ():
        around = scipy.ndimage.median_filter(channel.values, AROUND, mode="reflect")
        usual = np.percentile(channel.values, MIDDLE)
        low, high = min(around.min(), usual[0]), max(around.max(), usual[1])
        away = np.abs(channel.values - around) > SPAN * (high - low)
        beyond = np.flatnonzero(away)
        if high > low and len(beyond):
            worst, spikes = _farthest(channel.values, beyond), counted(scipy.ndimage.label(away)[1], "spike")
            found.append(
                f"{channel.what}: output {channel.variable.name} has {spikes}, the first at "
                f"{channel.at(int(beyond[0]))}, the farthest to {channel.values[worst]:.6g} {channel.variable.unit} at "
                f"{channel.at(worst)}, where all else is within {low:.4g} and {high:.4g}: repair the driver or the "
                "sensor, or leave those parts out (--part)"
            )
    return found


def slowness(record: Record, rig: Rig) -> list[str]:
    """A line on a record that is sampled far more slowly than the rig is simulated."""
    times = record.sampling_time / rig.step
    if times < SLOWER:
        return []
    unit = "ms" if times < 1e3 * SLOWER else "us"
    return [
        f"record {record.name}: samples are {record.sampling_time:.4g} s apart, {times:.3g} times the step of "
        f"{rig.name}, {rig.step:g} s: are its times in {unit}? they are taken for s; else correct step in {rig.file}"
    ]


def strangeness(record: Record, model: Model, rig: Rig, signals: Signals) -> list[str]:
    """Lines on inputs and outputs that go FARTHER than those in a model's training records."""
    found = []
    for channel in (*_inputs(record, rig, signals), *_outputs(record, rig, signals)):
        trained = np.abs(model.training_range.get(channel.variable.name, (np.inf, np.inf))).max()
        beyond = np.flatnonzero(np.abs(channel.values) > FARTHER * trained)
        if trained > 0.0 and len(beyond):
            worst, unit = _farthest(channel.values, beyond), channel.variable.unit
            found.append(
                f"{channel.what}: {channel.variable.name} goes to {channel.values[worst]:.6g} {unit}, "
                f"{abs(channel.values[worst]) / trained:.3g} times as far as what the model was trained on; "
                f"{len(beyond)} of {record.samples} samples are beyond {FARTHER:g} times, the first at "
                f"{channel.at(int(beyond[0]))}: is it in {unit}? if not, set its scale (--signals)"
            )
    return found


def _farthest(values: Array, among: NDArray[np.intp]) -> int:
    return int(among[np.argmax(np.abs(values[among]))])


def _inputs(record: Record, rig: Rig, signals: Signals | None) -> list[RecordChannel]:
    return _channels(record, record.input, rig.system.inputs, signals)


def _outputs(record: Record, rig: Rig, signals: Signals | None) -> list[RecordChannel]:
    return _channels(record, record.output, rig.system.outputs, signals)


def _channels(
    record: Record, values: Array, variables: Sequence[Variable], signals: Signals | None
) -> list[RecordChannel]:
    def what(name: str) -> str:
        if signals is None:
            return f"record {record.name}"
        signal = signals.inputs.get(name) or signals.outputs[name]
        return f"{record.source or record.name}: topic {signals.topic(signal)}: {signal.field}"

    return [
        RecordChannel(what=what(variable.name), variable=variable, period=record.sampling_time, values=column)
        for variable, column in zip(variables, values.T, strict=True)
    ]
