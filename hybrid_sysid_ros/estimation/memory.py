"""What the compiled code of an estimator works on, made once: settings, channels, moments of time and past inputs.

Settings are one NumPy record whose type is the same for every system, so that loops are compiled once; its arrays,
whose sizes the system decides, it names by their addresses.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.trace import shown_states
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array, Records

LONGEST_STEP = 0.005
"""Longest integration step of a prediction [s]; the models are identified at this step or a shorter one."""

LONGEST_GAP = 1.0
"""Time without a measurement [s] over which a prediction is worth less than starting from the next measurement."""

HUM_OBSERVABLE = 0.1
"""Smallest |sin(pi f T)| at which a hum of f looks different from a constant when sampled every T."""

SAME = 1e-6
"""Stamps less than this apart [s] are one."""

EMPTY, GIVEN, USED, GATED, BEGUN = 0, 1, 2, 3, 4
"""Fate of a reading: there is none, not looked at yet, used, an outlier, what the estimator began with."""

_INTEGERS = (
    *("states", "inputs", "outputs", "channels", "size", "followed", "hums"),  # how many
    *("step", "output", "weights"),  # addresses of functions and weights
    *("windowed", "keep", "count", "at", "fresh", "wrong"),
    # addresses of arrays, whose shapes memory_of() has
    *("parameters", "followed_index", "low", "high", "start", "process", "input_noise", "delays", "turning", "applied"),
    *("means", "roots", "predicted", "filtered", "predicted_roots", "slopes"),
    *("rows", "sensitivity", "expected", "variance", "by_output", "shown", "above_shown", "below_shown"),
    *("point", "centre", "above", "below", "gain", "acting", "drive", "pushed", "z"),
)
_NUMBERS = ("longest_step", "slack", "span", "gate", "lead")
CORE = np.dtype([*((name, "i8") for name in _INTEGERS), *((name, "f8") for name in _NUMBERS)])
"""windowed: whether the method optimises over the last ``span`` [s]. count: moments in use, keep: how many stay when
there is no room, at: the one of the last measurement, fresh: the first one that was made for it; wrong: inputs that
came with it and were no numbers. An interval becomes ceil(interval / longest_step - slack) steps. lead [s]: how far
ahead an answer looks. gate: largest normalised squared innovation to believe.
"""

CHANNEL = np.dtype([("state", "i8"), ("output", "i8"), ("hum", "i8"), ("noise", "f8")])
"""state: the one that is measured, -1: the output of the map. hum: place of its sine in z, -1: none. noise: variance.
"""

MOMENT = np.dtype([("time", "f8"), ("row", "i8")])
"""time [s]; row: of its belief and its readings in the arrays."""

READING = np.dtype([("value", "f8"), ("innovation", "f8"), ("normalised", "f8"), ("fate", "i8"), ("outliers", "i8")])
"""Of a channel at a moment; innovation before any of the moment's readings, its normalised square after those of the
channels before; outliers: in a row up to here.
"""


@intrinsic
def _at(typingctx, address):  # type: ignore[no-untyped-def]
    """A pointer to numbers from an address."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())

    return types.CPointer(types.float64)(types.int64), build


@inner
def numbers(address: int) -> Any:
    """What is at an address, without a length."""
    return _at(address)


@inner
def vector(address: int, length: int) -> Array:
    """The array (length,) at an address."""
    return carray(_at(address), (length,))  # type: ignore[no-any-return]


@inner
def matrix(address: int, rows: int, columns: int) -> Array:
    """The array (rows, columns) at an address."""
    return carray(_at(address), (rows, columns))  # type: ignore[no-any-return]


@inner
def mean_of(core: Any, row: int) -> Array:
    """Mean (size,) of a belief."""
    return vector(core.means + 8 * row * core.size, core.size)


@inner
def root_of(core: Any, row: int) -> Array:
    """Root (size, size) of its covariance."""
    return matrix(core.roots + 8 * row * core.size * core.size, core.size, core.size)


class Memory(NamedTuple):
    """What kernels are given first, as a plain tuple, as Python passes on a named one four times as slowly: records
    of the types above, and the past inputs.

    z = [x, d, hums, theta] of ``size`` entries: states, offset of each input, sine and cosine of the hum of each output
    that hums, and the followed parameters.
    """

    core: Records
    """(1,) of CORE."""
    channels: Records
    """(channels,) of CHANNEL: the outputs, then the tuning's further ones."""
    moments: Records
    """(capacity,) of MOMENT."""
    readings: Records
    """(capacity, channels) of READING."""
    inputs: Array
    """(length, 1 + inputs): end of an interval [s], integral of each input up to there; oldest first."""


def memory_of(
    system: System, tuning: Tuning, *, period: float, step: float, span: float, lead: float, windowed: bool
) -> tuple[Memory, dict[str, Array]]:
    """A memory for measurements every ``period`` [s] that reaches back over ``span`` [s], and its arrays by name, which
    must live as long.

    tuning: as :meth:`~.tuning.Tuning.checked` gives it. step: longest one of a prediction [s].
    """
    n, m, p = len(system.states), len(system.inputs), len(system.outputs)
    channels, hums = _channels(system, tuning, period)
    known = _known(system, tuning, hums)
    count, size = len(channels), len(known["start"])
    keep = (2 + math.ceil((span + LONGEST_GAP) / min(period, step))) * (1 + len(tuning.channels))
    capacity, past = 2 * keep + 2, math.ceil((span + system.delay) / period) + 64
    windows = capacity if windowed else 0
    shapes: list[tuple[tuple[int, ...], str]] = [
        ((capacity, size), "means"),
        ((capacity, size, size), "roots"),
        ((windows, size), "predicted filtered"),
        ((windows, size, size), "predicted_roots slopes"),
        ((3 * size + 2 * m + 1, size), "rows"),
        ((count, size), "sensitivity"),
        ((p, size), "by_output"),
        ((count,), "expected variance"),
        ((2 * p,), "shown above_shown below_shown"),
        ((size,), "point centre above below gain z"),
        ((m,), "acting drive pushed applied"),
    ]
    arrays = known | {name: np.zeros(shape) for shape, names in shapes for name in names.split()}
    core = np.zeros(1, CORE)
    settings = {
        "states": n,
        "inputs": m,
        "outputs": p,
        "channels": count,
        "size": size,
        "followed": len(tuning.followed),
        "hums": len(hums),
        "step": compiled(system).step,
        "output": compiled(system).output,
        "windowed": windowed,
        "keep": keep,
        "longest_step": step,
        "slack": 1e-6 if system.sampling_time is None else 0.5,
        "span": span,
        "gate": tuning.gate,
        "lead": lead,
        **{name: value.ctypes.data for name, value in arrays.items()},
    }
    for name, value in settings.items():
        core[name] = value
    moments = np.zeros(capacity, MOMENT)
    moments["row"] = np.arange(capacity)
    memory = Memory(core, channels, moments, np.zeros((capacity, count), READING), np.zeros((2 * past, 1 + m)))
    return memory, arrays


def _known(system: System, tuning: Tuning, hums: list[int]) -> dict[str, Array]:
    """What is known of z, of the inputs and of the system's own numbers; hums: outputs whose hum is estimated."""
    n, m = len(system.states), len(system.inputs)
    first = n + m
    tail = first + 2 * len(hums)
    names = [item.name for item in system.parameters]
    chosen = [names.index(name) for name in tuning.followed]
    per_second, start = np.zeros(tail + len(chosen)), np.zeros(tail + len(chosen))
    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    per_second[:first] = [*tuning.process_noise, *tuning.disturbance_noise]
    per_second[first:tail] = np.repeat([tuning.hum_noise[output] for output in hums], 2)
    per_second[tail:] = [*tuning.followed.values()]
    start[:n], start[n:] = tuning.initial_deviation, 10.0 * per_second[n:]
    start[first:tail] = np.repeat([tuning.hum_amplitude[output] for output in hums], 2)
    low[n:first], high[n:first] = -np.array(tuning.disturbance_limit), tuning.disturbance_limit
    low[tail:] = [system.parameters[index].low for index in chosen]
    high[tail:] = [system.parameters[index].high for index in chosen]
    known = {
        "parameters": system.values,
        "weights": system.weights,
        "followed_index": chosen,
        "low": low,
        "high": high,
        "start": start,
        "process": per_second**2,
        "input_noise": tuning.input_noise,
        "delays": system.input_delays,
        "turning": [2.0 * np.pi * tuning.hum_hertz[output] for output in hums],
    }
    return {name: np.array(values, dtype=float) for name, values in known.items()}


def _channels(system: System, tuning: Tuning, period: float) -> tuple[Records, list[int]]:
    """The channels, and the outputs whose hum is estimated.

    Sampled at a multiple of its period a hum looks like a constant: then it can only count as noise.
    """
    offset = len(system.states) + len(system.inputs)
    states, outputs = shown_states(system), [item.name for item in system.outputs]
    names = [item.name for item in system.states]
    found: list[tuple[int, int, int, float]] = []
    hums: list[int] = []
    for k, (noise, hertz, amplitude) in enumerate(
        zip(tuning.measurement_noise, tuning.hum_hertz, tuning.hum_amplitude, strict=True)
    ):
        there = hertz > 0.0 and amplitude > 0.0
        seen = there and abs(math.sin(math.pi * hertz * period)) > HUM_OBSERVABLE
        hum = offset + 2 * len(hums) if seen else -1
        found.append((states[k], k, hum, noise**2 + (amplitude**2 if there and not seen else 0.0)))
        hums += [k] if seen else []
    for channel in tuning.channels.values():
        output = outputs.index(channel.of) if channel.of in outputs else -1
        state = states[output] if output >= 0 else names.index(channel.of)
        found.append((state, output, -1, channel.noise**2))
    return np.array(found, dtype=CHANNEL), hums
