"""Initialisation of an estimator: its memory, which is made once, and its initial beliefs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.rollout import advance
from hybrid_sysid_ros.core.trace import shown_states
from hybrid_sysid_ros.estimation.belief import CHANNEL, CORE, EMPTY, GIVEN, INITIALISED, MOMENT, READING, USED, Memory
from hybrid_sysid_ros.estimation.measurement_sequence import LARGEST_INPUT
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array, Records

LONGEST_STEP = 0.005
"""Longest integration step of a prediction [s] where a model was identified at this step or a shorter one."""

LONGEST_GAP = 1.0
"""Time without a measurement [s] after which an estimator starts again from the next one."""

SPARE = 32
"""Moments for which memory has room beyond those that are needed: it is moved up once for as many."""

HUM_OBSERVABLE = 0.1
"""Smallest |sin(pi f T)| at which a hum of frequency f, sampled every T, can be distinguished from a constant."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Initialisation:
    """Writes initial beliefs of kernels at a moment of a memory. Measured states begin at their readings, others at the
    values of :meth:`~hybrid_sysid_ros.core.System.record_map`, with the deviations of the tuning.
    """

    system: System
    tuning: Tuning
    memory: Memory
    arrays: dict[str, Array]

    def fresh(self, time: float, applied: Array, first: int, values: Array) -> None:
        """Prepare to begin at ``time`` [s] with values of the channels from ``first`` on and inputs that were constant
        at ``applied`` (inputs,), without other knowledge.
        """
        memory, known = self.memory, self.arrays["applied"]
        memory.core["count"] = 1
        memory.moments["time"][0] = time
        known[:] = np.where(np.abs(applied) <= LARGEST_INPUT, applied, known)
        back = np.arange(1.0 - len(memory.inputs), 1.0)
        memory.inputs[:, 0], memory.inputs[:, 1:] = time + back, back[:, None] * known
        readings = self._readings(0)
        readings["fate"] = EMPTY
        here = slice(first, first + len(values))
        readings["value"][here] = values
        readings["fate"][here] = np.where(np.isfinite(values), GIVEN, EMPTY)
        mean = np.zeros(len(self.arrays["start"]))
        named, tail = self.system.named, len(mean) - len(self.tuning.followed)
        mean[tail:] = [named[name] for name in self.tuning.followed]
        self._write(0, *self._belief(0, mean, ()))

    def again(self, index: int, lost: Sequence[int]) -> bool:
        """Prepare to begin again at a moment, from its readings, because the channels ``lost`` were outliers for too
        long; offsets and parameters stay. False where another channel contradicts them that was accepted meanwhile.
        """
        row = self.memory.moments["row"][index]
        before, root = self.arrays["means"][row].copy(), self.arrays["roots"][row]
        mean, deviations, initialised = self._belief(index, before, lost)
        fates = self.memory.readings["fate"][self.memory.moments["row"][: index + 1]]
        accepted = (fates == USED) | (fates == INITIALISED)
        run = max((int(np.flatnonzero(accepted[:, c])[-1]) + 1 if accepted[:, c].any() else 0) for c in lost)
        change = self._shown(mean) - self._shown(before)
        variance = (
            self.memory.channels["noise"] + self._variance(mean, np.diag(deviations)) + self._variance(before, root)
        )
        for c in range(len(change)):
            measured = accepted[run:, c][fates[run:, c] != EMPTY]
            if c not in lost and measured.size and measured[-1] and change[c] ** 2 > self.tuning.gate * variance[c]:
                return False
        self._write(index, mean, deviations, initialised)
        return True

    def last_outputs(self) -> Array:
        """The newest reading of each output (outputs,), 0 where there was none."""
        rows = self.memory.moments["row"][: self.memory.core["count"][0]]
        found = np.zeros(len(self.system.outputs))
        for k in range(len(found)):
            measured = self.memory.readings[rows, k]
            values = measured["value"][measured["fate"] != EMPTY]
            found[k] = values[-1] if values.size else 0.0
        return found

    def _readings(self, index: int) -> Records:
        return self.memory.readings[self.memory.moments["row"][index]]

    def _belief(self, index: int, before: Array, lost: Sequence[int]) -> tuple[Array, Array, Sequence[int]]:
        """Mean and deviations (size,) from the readings of a moment, and the channels whose readings they contain.
        Those of ``lost`` come before others of the same state; offsets and parameters are as ``before`` (size,).
        """
        n, m, p = len(self.system.states), len(self.system.inputs), len(self.system.outputs)
        readings, channels = self._readings(index), self.memory.channels
        given = readings["fate"] != EMPTY
        outputs = np.where(given, readings["value"], np.nan_to_num(self._shown(before)))[:p]
        mean, deviations = before.copy(), self.arrays["start"].copy()
        mean[n + m : len(mean) - len(self.tuning.followed)] = 0.0
        mean[:n] = self.system.record_map().states_from_record(
            outputs[None], np.zeros((1, p)), self.arrays["applied"][None]
        )[0]
        initialised: dict[int, int] = {}
        for c in sorted(np.flatnonzero(given).tolist(), key=lambda c: c not in lost):
            state, hum = int(channels["state"][c]), int(channels["hum"][c])
            if state >= 0 and state not in initialised:
                initialised[state] = c
                mean[state] = readings["value"][c]
                amplitude = deviations[hum] if hum >= 0 else 0.0
                deviations[state] = np.hypot(np.sqrt(channels["noise"][c]), amplitude)
        return mean, deviations, list(initialised.values())

    def _write(self, index: int, mean: Array, deviations: Array, initialised: Sequence[int]) -> None:
        """Write the belief; a sensor without readings so far may overrule it with its first value."""
        readings = self._readings(index)
        given = readings["fate"] != EMPTY
        readings["fate"][given] = GIVEN
        readings["fate"][list(initialised)] = INITIALISED
        readings["outliers"] = np.where(given, 0, self.tuning.patience)
        row = self.memory.moments["row"][index]
        self.arrays["means"][row], self.arrays["roots"][row] = mean, np.diag(deviations)

    def _shown(self, z: Array) -> Array:
        """Readings of each channel at z (size,) without hum, (channels,)."""
        n, m, p = len(self.system.states), len(self.system.inputs), len(self.system.outputs)
        named = self.system.named | dict(
            zip(self.tuning.followed, z[len(z) - len(self.tuning.followed) :], strict=True)
        )
        inputs, outputs = self.arrays["applied"] + z[n : n + m], np.empty(p)
        values = np.array(list(named.values()))
        advance(compiled(self.system).output, z[:n].copy(), inputs, values, self.system.weights, 0.0, outputs)
        channels = self.memory.channels
        return np.where(channels["state"] >= 0, z[channels["state"]], outputs[channels["output"]])

    def _variance(self, z: Array, columns: Array) -> Array:
        """Variance of each channel's reading around z (size,), by the columns of a root (size, size)."""
        sides = [self._shown(z + column) - self._shown(z - column) for column in columns.T]
        return np.asarray(np.sum(np.square(sides), axis=0) / 4.0)


def memory_of(
    system: System, tuning: Tuning, *, period: float, step: float, span: float, lead: float, windowed: bool
) -> tuple[Memory, dict[str, Array]]:
    """A memory for measurements every ``period`` [s] that reaches back over ``span`` [s], and its arrays by name, which
    must live as long as the memory.

    tuning: the result of :meth:`~.tuning.Tuning.checked`. step: longest step of a prediction [s].
    """
    n, m, p = len(system.states), len(system.inputs), len(system.outputs)
    channels, hums = _channels(system, tuning, period)
    known = _known(system, tuning, hums)
    count, size = len(channels), len(known["start"])
    longest = span + max(LONGEST_GAP, 1.5 * period)  # an interval without a measurement, all of whose steps are kept
    keep = (2 + math.ceil(longest / min(period, step))) * (1 + len(tuning.channels))
    capacity, past = keep + SPARE, math.ceil((span + system.delay) / period) + 64
    windows = capacity if windowed else 0
    shapes: list[tuple[tuple[int, ...], str]] = [
        ((capacity, size), "means"),
        ((capacity, size, size), "roots"),
        ((windows, size), "predicted filtered"),
        ((windows, size, size), "predicted_roots transitions"),
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
    """Constants of z, of the inputs and of the system by name; hums: outputs whose hum is estimated."""
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
    start[:n] = np.minimum(tuning.initial_deviation, np.array(tuning.state_limit) / math.sqrt(3.0))
    start[n:] = 10.0 * per_second[n:]
    start[first:tail] = np.repeat([tuning.hum_amplitude[output] for output in hums], 2)
    low[:n], high[:n] = -np.array(tuning.state_limit), tuning.state_limit
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

    A hum that is sampled at a multiple of its period looks like a constant: then it counts as noise.
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
