"""Innovations of a record: what each reading adds to what an extended Kalman filter expected of it.

    x(k + 1) = f(x(k), u(k) + d(k); theta),  d(k + 1) = d(k) + q sqrt(h) w(k),  y(k) = h(x(k), u(k) + d(k)) + r e(k)

with w and e of deviation one: the offset d of each input is a random walk of q per root of a second, the noise of each
sensor is r. The filter is that of the loop (:mod:`~hybrid_sysid_ros.estimation.extended_kalman_filter`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.addresses import matrix, numbers_at
from hybrid_sysid_ros.core.compilation import kernel
from hybrid_sysid_ros.estimation.extended_kalman_filter import predict
from hybrid_sysid_ros.estimation.initialisation import Initialisation, memory_of
from hybrid_sysid_ros.estimation.measurement_sequence import begin, put, replay
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array


def innovations(
    system: System, record: PreparedRecord, *, walks: Array, noise: Array, spreads: Array
) -> tuple[Array, Array]:
    """Innovations and their variances, (samples - 1, outputs) each, of the outputs in turn, each after those before it;
    NaN where a sample was not measured.

    walks q (inputs,) [input unit / sqrt(s)], noise r (outputs,), spreads (states,): deviations of states that the first
    sample does not show. That sample begins the filter, with an offset of 10 q.
    """
    sampling = record.sampling
    tuning = Tuning(
        measurement_noise=tuple(noise.tolist()),
        process_noise=(0.0,) * len(system.states),
        disturbance_noise=tuple(walks.tolist()),
        disturbance_limit=(math.inf,),
        initial_deviation=tuple(spreads.tolist()),
        gate=1e300,
        window=0.0,
    ).checked(system)
    memory, arrays = memory_of(
        system, tuning, period=sampling.step, step=sampling.step, span=0.0, lead=0.0, windowed=False
    )
    start = Initialisation(system=system, tuning=tuning, memory=memory, arrays=arrays)
    followed = record.followed
    start.fresh(0.0, record.inputs[0], 0, followed[0])
    outputs = followed if record.measured is None else np.where(record.measured[:, None], followed, np.nan)
    found = np.full((2, record.samples - 1, len(system.outputs)), np.nan)
    _innovations(tuple(memory), np.ascontiguousarray(outputs), record.inputs, sampling.step, sampling.every, found)
    return found[0], found[1]


@kernel
def _innovations(memory: Any, outputs: Array, inputs: Array, step: float, every: int, found: Array) -> None:
    """Write innovations and variances (2, samples - 1, outputs)."""
    cores, channels, moments, readings, past = memory
    core = cores[0]
    begin(core, channels, moments, readings, past, 0)
    nothing = np.full(outputs.shape[1], np.nan)
    for sample in range(1, outputs.shape[0]):
        for i in range(every):
            at = (sample - 1) * every + i
            given = outputs[sample] if i == every - 1 else nothing
            changed = put(core, moments, readings, past, (at + 1) * step, at * step, 0, given, inputs[at])
            if changed >= 0:
                replay(core, channels, moments, readings, past, changed, predict)
        expected, noise = numbers_at(core.expected), numbers_at(core.variance)
        sensitivity = matrix(core.sensitivity, core.channels, core.size)
        for k in range(outputs.shape[1]):
            if math.isfinite(outputs[sample, k]):
                variance = noise[k]
                for i in range(core.size):
                    variance += sensitivity[k, i] * sensitivity[k, i]
                found[0, sample - 1, k] = outputs[sample, k] - expected[k]
                found[1, sample - 1, k] = variance
