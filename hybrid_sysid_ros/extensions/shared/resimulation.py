"""Closed-loop re-simulation: model, controller and filter are simulated from the reference alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.rollout import Dynamics, dynamics
from hybrid_sysid_ros.identification.experiment import PreparedRecord, prepare
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.identification.validation.scores import Scores, score
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import LowPass, LowPassFilter
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

WHOLE = Part()
SWEEPS = 4
"""Iterations of a step: two are exact for steps of 5 and 10 ms; at 50 ms each is 15 times more accurate."""
STRAYED = 0.05
"""Share of a record's inputs that may differ from the rig's law, such as where a recorder lost samples. For loops under
the law, recorded every 1 to 50 ms, it is at most .02, for loops of the MPC at least .6, and with nine tenths of the
gain mostly .5.
"""
DEVIATIONS = 3.0
"""Deviations of the sensor's noise within which a filtered position is known that is computed from the output."""
ROUNDING = 1e-7
"""Rounding of a recorded input, relative to its range, as in single precision."""
WARM_UP = 1.0
"""Seconds of measured output before a part that a filter processes; its memory is a quarter of that."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Resimulation:
    """An experiment that is repeated on a model, and its scores against the record."""

    name: str
    time: Array
    """Times of the model's steps, or of the record's samples where these are longer, (samples,) [s]."""
    measured: Array
    """Output in the record, in its unit, (samples,)."""
    simulated: Array
    """Simulated output in its unit, (samples,)."""
    simulated_input: Array
    """Simulated mean inputs between samples, (samples - 1,)."""
    output: Scores
    input: Scores


def resimulate(
    system: System, record: Record, rig: Rig, *, sampling: Sampling, part: Part = WHOLE,
    output_error: Array | None = None,
) -> Resimulation:  # fmt: skip
    """Repeat an experiment of a rig on a model: u = clip(gain (reference - yf), +-limit).

    yf is the output behind the low-pass of the rig's sensor. Reference and initial state come from the record;
    everything else is simulated, so an error of the model acts back on its input as on the rig.

    Controller and filter run at the rig's step (1 ms), the model at its own, which is a multiple, since its parameters
    belong to that step. Over one step of the model the filter gets the output on a straight line from the old to the
    new value, and the model gets the mean of the input, or with sampling.input "sampled" the first of each period, as
    in its fit. Since each needs the other, a step longer than the rig's is iterated SWEEPS times, at first with a
    constant output; the output within a step reaches the input only through six integrations. The filter begins in
    steady state at the record's filtered position; before a part within the record it processes the measured output.
    output_error: what its sensor adds to the simulated output, (samples,); an error behind the filter acts as a
    reference that is as much lower.

    Raises UserError where the record has no reference or was driven by another controller, the rig has more than one
    input or output, the step is no multiple of the rig's, or the record does not fit the sampling.
    """
    if not rig.experiments.loops:
        raise UserError(f"rig {rig.name} has no loop (experiments.loops) to re-simulate")
    ticks = rig.steps(sampling.step, "re-simulation: the model's step")
    if len(system.inputs) != 1 or len(system.outputs) != 1:
        raise UserError(f"only loops of one input and output are re-simulated; {rig.name} has more")
    filtered = _low_pass(rig)
    recorded = "filtered" in record.channels
    if not recorded:
        record = replace(record, channels={**record.channels, "filtered": _filtered(record, rig)})
    used = part.of(record, sampling)
    sensor = rig.sensors[0]
    count = sensor.quantiser.count if sensor.quantiser else 0.0
    _check_law(used, rig, count if recorded else DEVIATIONS * sensor.noise)
    grid = replace(sampling.at(max(sampling.step, used.sampling_time)), input="averaged")
    experiment = prepare(used, system, grid)
    steps = len(experiment.inputs)
    reference = _reference(used, rig, steps * ticks)
    if output_error is not None:
        seen, ticks_of = LowPassFilter(filtered, rig.step), rig.step * np.arange(len(reference))
        seen.reset(float(output_error[0]))
        samples_of = grid.period * np.arange(len(output_error))
        reference = reference - _through(seen, np.interp(ticks_of, samples_of, output_error))
    outputs, applied = np.empty(steps + 1), np.empty(steps)
    low_pass = _settled(LowPassFilter(filtered, rig.step), record, rig, part.first(record, sampling))
    functions = compiled(system)
    hold = round(sampling.period / sampling.step) if sampling.input == "sampled" else 1
    _loop(
        dynamics(functions.step, functions.output, system, sampling.step),
        (hold, 1 if ticks == 1 else SWEEPS),
        reference,
        (low_pass.transition, low_pass.gain, low_pass.reading),
        low_pass.state,
        (rig.experiments.loops[0].gain / rig.display[0].scale, rig.actuators[0].low, rig.actuators[0].high),
        initial_state(system, experiment),
        outputs,
        applied,
    )
    return _compared(used.name, experiment, outputs[:: grid.every], applied)


def _reference(record: Record, rig: Rig, ticks: int) -> Array:
    """The reference at the rig's steps, (steps,), in the output's unit."""
    reference = record.channels.get("reference")
    if reference is None:
        raise UserError(f"{record.name}: has no channel reference, which a loop follows; name its topic in the signals")
    if not np.isfinite(reference).all():
        first = int(np.argmax(~np.isfinite(reference)))
        raise UserError(f"{record.name}: the reference is unknown at sample {first}; use a part where it is known")
    return np.asarray(np.interp(rig.step * np.arange(ticks), record.time, reference))


def _check_law(record: Record, rig: Rig, tolerance: float) -> None:
    """Raise UserError for a record of another controller, or of none, since the rig's law can't repeat it.

    Between two samples the law's input goes from one clip(gain (reference - filtered)) to the next, so its mean in the
    record lies between them. This range is widened by the curvature of the filtered position, an eighth of its second
    differences, and by ``tolerance``, in the unit of the filtered output.
    """
    if "reference" not in record.channels:
        return
    gain, low_limit, high_limit = rig.experiments.loops[0].gain, rig.actuators[0].low, rig.actuators[0].high
    scale = gain / rig.display[0].scale
    correction = scale * (record.channels["reference"] - record.channels["filtered"])
    bends = np.abs(np.diff(record.channels["filtered"], 2)) / 8.0
    bend = np.maximum(np.append(bends, bends[-1:]), np.insert(bends, 0, bends[:1]))
    slack = scale * bend + gain * tolerance
    low = np.clip(np.minimum(correction[:-1], correction[1:]) - slack, low_limit, high_limit)
    high = np.clip(np.maximum(correction[:-1], correction[1:]) + slack, low_limit, high_limit)
    known = np.isfinite(low + high)
    given = record.input[:-1, 0]
    rounding = ROUNDING * (high_limit - low_limit)
    strayed = (given < low - rounding) | (given > high + rounding)
    if known.any() and np.mean(strayed[known]) > STRAYED:
        raise UserError(
            f"{record.name}: {np.mean(strayed[known]):.0%} of its inputs are not those of the rig's controller, "
            "clip(gain (reference - filtered)), so the loop can't be repeated with it"
        )


def _low_pass(rig: Rig) -> LowPass:
    """The filter of the rig's controller. Raises UserError where the loop can't be repeated."""
    found = rig.sensors[0].low_pass
    if not rig.experiments.loops or found is None:
        raise UserError(f"rig {rig.name} has no loop behind a low-pass that could be repeated")
    if rig.experiments.loops[0].integral:
        raise UserError(f"the loop of rig {rig.name} has an integral part, which can't be repeated")
    return found


def _filtered(record: Record, rig: Rig) -> Array:
    """The output behind the rig's filter, (samples,), in the output's unit, beginning in steady state."""
    low_pass = LowPassFilter(_low_pass(rig), rig.step)
    ticks = rig.step * np.arange(round(record.time[-1] / rig.step) + 1)
    values = np.interp(ticks, record.time, record.output[:, 0])
    low_pass.reset(float(values[0]))
    return np.asarray(np.interp(record.time, ticks, _through(low_pass, values)))


def _settled(low_pass: LowPassFilter, record: Record, rig: Rig, first: int) -> LowPassFilter:
    """The filter in its state at a sample of the record."""
    ticks = min(round(first * record.sampling_time / rig.step), round(WARM_UP / rig.step))
    times = record.sampling_time * first - rig.step * np.arange(ticks, 0, -1)
    before = np.interp(times, record.time, record.output[:, 0])
    filtered = record.channels["filtered"]
    settled = before[0] if ticks else filtered[0] if np.isfinite(filtered[0]) else record.output[0, 0]
    low_pass.reset(float(settled))
    _through(low_pass, before)
    return low_pass


def _through(low_pass: LowPassFilter, values: Array) -> Array:
    """The output of a filter before it processes each of the values, (steps,)."""
    shown = np.empty(len(values))
    for tick, value in enumerate(values.tolist()):
        shown[tick] = low_pass.value
        low_pass.advance(value)
    return shown


@kernel
def _loop(
    model: Dynamics,
    timing: tuple[int, int],
    reference: Array,
    low_pass: tuple[Array, Array, Array],
    seen: Array,
    law: tuple[float, float, float],
    x: Array,
    outputs: Array,
    applied: Array,
) -> None:
    """Fill outputs (steps + 1,) and applied (steps,), the mean input over each step, advancing the filter's state
    ``seen`` and the model's x (states,). timing: samples for which an input is held, and sweeps.
    """
    step, output, p, w, h, delays = model
    hold, sweeps = timing
    steps = applied.shape[0]
    ticks = reference.shape[0] // steps
    whole = int(delays[0])
    part = delays[0] - whole
    driven, u, y = np.empty(steps), np.zeros(1), np.empty(1)
    now, room, following = seen.copy(), seen.copy(), x.copy()
    call_value(output, x, u, p, w, h, 0.0, y)
    outputs[0] = y[0]
    for k in range(steps):
        wanted = reference[k * ticks : (k + 1) * ticks]
        for _ in range(sweeps):
            now[:] = seen
            mean, first = _over_a_step(wanted, outputs[k], y[0], low_pass, law, now, room)
            applied[k] = driven[k] = mean
            if hold > 1:
                driven[k] = first if k % hold == 0 else driven[k - 1]
            u[0] = (1.0 - part) * driven[max(k - whole, 0)] + part * driven[max(k - whole - 1, 0)]
            call_value(step, x, u, p, w, h, 0.0, following)
            call_value(output, following, u, p, w, h, 0.0, y)
        seen[:] = now
        x[:] = following
        outputs[k + 1] = y[0]


@inner
def _over_a_step(
    wanted: Any, begin: float, end: float, low_pass: Any, law: Any, state: Any, room: Any
) -> tuple[float, float]:
    """Mean and first input over a step of the model, while its output goes from begin to end on a straight line. room:
    memory for another state of the filter.
    """
    transition, gain, reading = low_pass
    feedback, low, high = law
    ticks = wanted.shape[0]
    total = first = 0.0
    for j in range(ticks):
        filtered = 0.0
        for i in range(state.shape[0]):
            filtered += reading[i] * state[i]
        value = min(max(feedback * (wanted[j] - filtered), low), high)
        total += value
        if j == 0:
            first = value
        shown = begin + (end - begin) * j / ticks
        for i in range(state.shape[0]):
            room[i] = gain[i] * shown
            for column in range(state.shape[0]):
                room[i] += transition[i, column] * state[column]
        state[:] = room
    return total / ticks, first


def _compared(name: str, experiment: PreparedRecord, simulated: Array, applied: Array) -> Resimulation:
    measured, every = experiment.outputs[:, 0], experiment.sampling.every
    inputs = experiment.inputs[:, 0].reshape(-1, every).mean(axis=1)
    again = applied.reshape(-1, every).mean(axis=1)
    return Resimulation(
        name=name,
        time=np.asarray(experiment.sampling.period * np.arange(experiment.samples), dtype=float),
        measured=measured,
        simulated=simulated,
        simulated_input=again,
        output=score(measured, simulated),
        input=score(inputs, again),
    )
