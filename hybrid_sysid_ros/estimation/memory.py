"""What the compiled code of an estimator works on, made once: numbers, channels, nodes of time and past inputs.

All are NumPy records, which compiled code reads by name and takes at the price of a pointer.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Recurrence, System
from hybrid_sysid_ros.estimation.tuning import Tuning

LONGEST_STEP = 0.005
"""Longest integration step of a prediction [s]; the models are identified at this step or a shorter one."""

LONGEST_GAP = 1.0
"""Time without a measurement [s] over which a prediction is worth less than starting from the next measurement."""

HUM_OBSERVABLE = 0.1
"""Smallest |sin(pi f T)| at which a hum of f looks different from a position when sampled every T."""

MAIN = 0
"""Channel of the measurements that update() is given; the tuning's further ones follow."""

NONE = -1
"""Channel of a node without a measurement."""

UNUSED, USED, GATED, RESET = 0, 1, 2, 3
"""What became of a node's measurement: nothing to use, used, an outlier, what the estimator started from again."""


class Memory(NamedTuple):
    """core (1,), channels (channels,), nodes (capacity,), inputs (length,): records of the types below.

    The augmented state is z = [x, d, s, c, theta]: the model's (states,), input disturbance, hum and its quadrature,
    and the followed parameters; ``size`` in all.
    """

    core: NDArray[np.void]
    channels: NDArray[np.void]
    nodes: NDArray[np.void]
    inputs: NDArray[np.void]


CHANNEL = np.dtype([("row", "i8"), ("noise", "f8"), ("hum", "f8")])
"""row: state that is measured; noise: variance of a measurement; hum: 1 where the hum is in it, else 0."""

INPUT = np.dtype([("time", "f8"), ("integral", "f8")])
"""End of an interval [s], and the integral of the input up to there."""


def node_type(size: int, *, window: bool = False) -> np.dtype[np.void]:
    """A node: time [s], value and channel of a measurement; innovation, its normalised square, and its fate.

    mean (size,), root (size, size): the belief behind it, root the covariance or a square root of it. outliers: in a
    row up to here. With a window, what its optimisation keeps: predicted (size,), predicted_covariance (size, size)
    before the measurement, filtered (size,) behind it, transition (size, size) from the node before.
    """
    numbers = [(name, "f8") for name in ("time", "value", "innovation", "normalised")]
    counts = [(name, "i8") for name in ("channel", "fate", "outliers")]
    vectors, matrices = ["mean"], ["root"]
    if window:
        vectors += ["predicted", "filtered"]
        matrices += ["predicted_covariance", "transition"]
    return np.dtype(
        [
            *numbers,
            *counts,
            *((name, "f8", (size,)) for name in vectors),
            *((name, "f8", (size, size)) for name in matrices),
        ]
    )


def core_type(size: int, parameters: int, weights: int) -> np.dtype[np.void]:
    """Numbers that stay, the count of nodes, and workspaces.

    numbers (parameters,): of the equation, the followed ones overwritten, weights (weights,) of what is learned.
    followed: indices of the followed parameters, given: their values in the equation. low, high (size,): bounds of z;
    process (size,): growth of the variance in a second; start (size,): variances at the start. delay [s]: of the
    input. step [s]: longest one of a prediction, an interval becoming ceil(interval / step - slack) steps. span [s]:
    how far back a window reaches. turning: of the hum [rad/s]. input_noise: its
    power [unit^2 s]. gate, patience: of outliers. keep: how many nodes stay
    when there is no room.
    """
    followed = max(size, 1)  # no fields without entries
    return np.dtype(
        [
            *((name, "f8") for name in ("delay", "step", "slack", "span", "turning", "gate", "input_noise")),
            *((name, "i8") for name in ("patience", "keep", "count")),
            ("numbers", "f8", (max(parameters, 1),)),
            ("weights", "f8", (max(weights, 1),)),
            ("followed", "i8", (followed,)),
            ("given", "f8", (followed,)),
            *((name, "f8", (size,)) for name in ("low", "high", "process", "start", "column", "direction", "push")),
            *((name, "f8", (size, size)) for name in ("jacobian", "product", "remainder")),
            ("points", "f8", (3 * size + 3, size)),
            ("drive", "f8", (1,)),
        ]
    )


def memory_of(system: System, tuning: Tuning, *, period: float, span: float, window: bool) -> Memory:
    """A memory for measurements every ``period`` [s] that reaches back over ``span`` [s].

    window: whether the method optimises over the span. A recurrence has one step only, its own period.
    """
    states, followed = len(system.states), len(tuning.followed)
    size, output = states + 3 + followed, system.measured[0]
    # Sampled at a multiple of its period a hum looks like a position: then it can only count as noise.
    hum = tuning.hum_hertz > 0 and abs(np.sin(np.pi * tuning.hum_hertz * period)) > HUM_OBSERVABLE
    hum_variance = tuning.hum_amplitude**2
    names = [item.name for item in system.parameters]
    chosen = [names.index(name) for name in tuning.followed]
    drift = np.array([*tuning.followed.values()], dtype=float)

    core = np.zeros(1, core_type(size, len(names), len(system.weights)))
    core["delay"], core["gate"], core["patience"] = system.delay, tuning.gate, tuning.patience
    recurrent = isinstance(system, Recurrence)
    step = core["step"] = system.period if isinstance(system, Recurrence) else LONGEST_STEP
    core["slack"] = 0.5 if recurrent else 1e-6
    core["span"] = span
    core["input_noise"] = tuning.input_noise**2
    core["turning"] = 2 * np.pi * tuning.hum_hertz if hum else 0.0
    core["numbers"][0, : len(names)] = system.values
    core["weights"][0, : len(system.weights)] = system.weights
    core["followed"][0, :followed] = chosen
    core["given"][0, :followed] = system.values[chosen]
    low, high, process, start = (core[name][0] for name in ("low", "high", "process", "start"))
    low[:], high[:] = -np.inf, np.inf
    low[states], high[states] = -tuning.disturbance_limit, tuning.disturbance_limit
    low[states + 3 :] = [system.parameters[index].low for index in chosen]
    high[states + 3 :] = [system.parameters[index].high for index in chosen]
    hum_drift = tuning.hum_noise if hum else 0.0
    process[:] = np.array([*tuning.process_noise, tuning.disturbance_noise, hum_drift, hum_drift, *drift]) ** 2
    start[:] = 100 * process
    start[output] = tuning.measurement_noise**2 + hum_variance
    start[states + 1 : states + 3] = hum_variance if hum else 0.0

    noise = tuning.measurement_noise**2 + (0.0 if hum else hum_variance)
    channels = np.array(
        [(output, noise, float(hum)), *((item.state, item.noise**2, 0.0) for item in tuning.channels.values())],
        dtype=CHANNEL,
    )
    keep = (2 + math.ceil((span + LONGEST_GAP) / min(period, step))) * len(channels)
    core["keep"] = keep
    length = math.ceil((span + system.delay) / period) + 64
    return Memory(core, channels, np.zeros(2 * keep + 2, node_type(size, window=window)), np.zeros(length, INPUT))
