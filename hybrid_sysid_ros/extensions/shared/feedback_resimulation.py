"""Closed-loop re-simulation under a feedback: model and feedback are simulated from the commands alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.call import call_value
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.core.rollout import Dynamics, delayed, dynamics
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.part import Part
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.identification.validation.scores import Scores
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.feedback import Law, Limits, feedback_inputs, law_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

WHOLE = Part()


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """An experiment under a feedback that is repeated on a model, and its scores against the record."""

    outputs: Array
    """Simulated outputs, (samples, outputs)."""
    inputs: Array
    """Simulated inputs from each sample on, (samples - 1, inputs)."""
    scores: Scores
    """Scores of the outputs."""


def follow_again(system: System, record: Record, rig: Rig, *, sampling: Sampling, part: Part = WHOLE) -> Followed:
    """Repeat an experiment of a rig on a model, under the rig's feedback.

    Commands and initial state come from the record, and so do the added inputs: the recorded inputs less the feedback's
    answer to the recorded outputs, computed from the record's beginning, where the feedback was at rest. Everything
    else is simulated, so an error of the model acts back on its inputs.

    Raises UserError where the rig has no feedback, or one behind low-passes; the record is not sampled as the feedback
    works, or does not have its commands; the model's step does not fit.
    """
    feedback = rig.experiments.feedback
    if feedback is None or any(sensor.low_pass for sensor in rig.sensors):
        raise UserError(f"rig {rig.name} has no feedback (experiments.feedback) without low-passes")
    if abs(record.sampling_time / feedback.period - 1.0) > 1e-6:
        raise UserError(
            f"{record.name}: is sampled every {record.sampling_time:g} s, the feedback works every {feedback.period:g} "
            "s: only a record with each of its answers can be repeated"
        )
    names = [rig.channel("reference", rig.system.outputs[index].name) for index in feedback.followed]
    for name in names:
        values = record.channels.get(name)
        if values is None or not np.isfinite(values).all():
            raise UserError(f"{record.name}: channel {name}, a command of the feedback, is missing or has holes")
    commands = np.column_stack([record.channels[name] for name in names])
    fine = replace(sampling, step=min(sampling.step, feedback.period), input="averaged").at(feedback.period)
    first = part.first(record, fine)
    used = part.of(record, fine)
    experiment = prepare(used, system, fine)
    law, limits = law_of(feedback), rig.limits
    memory = np.zeros((len(feedback.followed), 2)), np.zeros(len(rig.actuators))
    added = _added(law, limits, record.output, commands, record.input, first, *memory)
    functions = compiled(system)
    count = experiment.samples
    outputs, applied = np.empty((count, len(system.outputs))), np.empty((count - 1, len(system.inputs)))
    span = slice(first, first + count - 1)
    _follow(
        dynamics(functions.step, functions.output, system, fine.step),
        (law, limits),
        (np.ascontiguousarray(commands[span]), np.ascontiguousarray(added[span])),
        memory,
        fine.every,
        initial_state(system, experiment),
        outputs,
        applied,
    )
    scores = Scores.of([item.name for item in system.outputs], experiment.outputs, outputs)
    return Followed(outputs=outputs, inputs=applied, scores=scores)


@kernel
def _added(
    law: Law, limits: Limits, outputs: Array, commands: Array, inputs: Array, first: int, model: Array, integrals: Array
) -> Array:
    """Inputs that were added to the feedback's answers (samples, inputs); model and integrals get their values at the
    sample ``first``.
    """
    low, high = limits
    wide = (np.full(low.shape, -np.inf), np.full(high.shape, np.inf))
    added, free, u, nothing = np.zeros(inputs.shape), np.empty(low.shape), np.empty(low.shape), np.zeros(low.shape)
    now, sums = model.copy(), integrals.copy()
    for k in range(inputs.shape[0]):
        if k == first:
            model[:] = now
            integrals[:] = sums
        feedback_inputs(law, wide, outputs[k], commands[k], nothing, now.copy(), sums.copy(), free)
        for j in range(low.shape[0]):
            at_limit = not low[j] < inputs[k, j] < high[j]
            expected = min(max(free[j], low[j]), high[j]) if at_limit else free[j]
            added[k, j] = inputs[k, j] - expected
        feedback_inputs(law, limits, outputs[k], commands[k], added[k], now, sums, u)
    return added


@kernel
def _follow(
    system: Dynamics,
    driver: tuple[Law, Limits],
    signals: tuple[Array, Array],
    memory: tuple[Array, Array],
    every: int,
    x: Array,
    outputs: Array,
    applied: Array,
) -> None:
    """Fill outputs (samples, outputs) and applied (samples - 1, inputs), advancing memory and states x (states,)."""
    step, output, p, w, h, delays = system
    law, limits = driver
    commands, added = signals
    model, integrals = memory
    u, acting, y, following = np.empty(added.shape[1]), np.empty(added.shape[1]), outputs[0].copy(), x.copy()
    held = np.empty((applied.shape[0] * every, added.shape[1]))
    u[:] = 0.0
    for sample in range(applied.shape[0]):
        call_value(output, x, u, p, w, h, 0.0, y)
        outputs[sample] = y
        feedback_inputs(law, limits, y, commands[sample], added[sample], model, integrals, u)
        applied[sample] = u
        for k in range(sample * every, (sample + 1) * every):
            held[k] = u
            delayed(held, delays, 0, k, acting)
            call_value(step, x, acting, p, w, h, 0.0, following)
            x, following = following, x
    call_value(output, x, u, p, w, h, 0.0, y)
    outputs[applied.shape[0]] = y
