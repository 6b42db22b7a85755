"""Where a belief begins: from the first measurement, and again from a sensor that the belief has lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import System, compiled
from hybrid_sysid_ros.core.rollout import advance
from hybrid_sysid_ros.estimation.memory import BEGUN, EMPTY, GIVEN, USED, Memory, Records
from hybrid_sysid_ros.estimation.tuning import Tuning
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Beginning:
    """Writes beliefs with which kernels then begin at a moment of a memory. States that are measured begin as they are,
    the others where :meth:`~hybrid_sysid_ros.core.System.record_map` puts them, with the deviations of the tuning.
    """

    system: System
    tuning: Tuning
    memory: Memory
    arrays: dict[str, Array]

    def fresh(self, time: float, applied: Array, first: int, values: Array) -> None:
        """Prepare to begin at ``time`` [s] with values of the channels from ``first`` on and inputs that have stood at
        ``applied`` (inputs,), nothing else known.
        """
        memory, known = self.memory, self.arrays["applied"]
        memory.core["count"] = 1
        memory.moments["time"][0] = time
        known[:] = np.where(np.isfinite(applied), applied, known)
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
        """Prepare to begin again at a moment, from its readings, for the sake of the channels ``lost`` that were
        outliers for too long; offsets and parameters stay. False where another channel that was believed meanwhile
        contradicts them.
        """
        row = self.memory.moments["row"][index]
        before, root = self.arrays["means"][row].copy(), self.arrays["roots"][row]
        mean, deviations, placed = self._belief(index, before, lost)
        fates = self.memory.readings["fate"][self.memory.moments["row"][: index + 1]]
        believed = (fates == USED) | (fates == BEGUN)
        run = max((int(np.flatnonzero(believed[:, c])[-1]) + 1 if believed[:, c].any() else 0) for c in lost)
        change = self._shown(mean) - self._shown(before)
        variance = (
            self.memory.channels["noise"] + self._variance(mean, np.diag(deviations)) + self._variance(before, root)
        )
        for c in range(len(change)):
            told = believed[run:, c][fates[run:, c] != EMPTY]
            if c not in lost and told.size and told[-1] and change[c] ** 2 > self.tuning.gate * variance[c]:
                return False
        self._write(index, mean, deviations, placed)
        return True

    def last_outputs(self) -> Array:
        """The newest value of each output (outputs,), 0 where there was none."""
        rows = self.memory.moments["row"][: self.memory.core["count"][0]]
        found = np.zeros(len(self.system.outputs))
        for k in range(len(found)):
            told = self.memory.readings[rows, k]
            values = told["value"][told["fate"] != EMPTY]
            found[k] = values[-1] if values.size else 0.0
        return found

    def _readings(self, index: int) -> Records:
        return self.memory.readings[self.memory.moments["row"][index]]

    def _belief(self, index: int, before: Array, lost: Sequence[int]) -> tuple[Array, Array, Sequence[int]]:
        """Mean and deviations (size,) by the readings of a moment, those of the channels ``lost`` before others of the
        same state, what is slow as it was ``before`` (size,); and the channels whose readings are in it already.
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
        placed: dict[int, int] = {}
        for c in sorted(np.flatnonzero(given).tolist(), key=lambda c: c not in lost):
            state, hum = int(channels["state"][c]), int(channels["hum"][c])
            if state >= 0 and state not in placed:
                placed[state] = c
                mean[state] = readings["value"][c]
                amplitude = deviations[hum] if hum >= 0 else 0.0
                deviations[state] = np.hypot(np.sqrt(channels["noise"][c]), amplitude)
        return mean, deviations, list(placed.values())

    def _write(self, index: int, mean: Array, deviations: Array, placed: Sequence[int]) -> None:
        """Write the belief; a sensor that has told nothing yet may win with its first value."""
        readings = self._readings(index)
        given = readings["fate"] != EMPTY
        readings["fate"][given] = GIVEN
        readings["fate"][list(placed)] = BEGUN
        readings["outliers"] = np.where(given, 0, self.tuning.patience)
        row = self.memory.moments["row"][index]
        self.arrays["means"][row], self.arrays["roots"][row] = mean, np.diag(deviations)

    def _shown(self, z: Array) -> Array:
        """What each channel shows at z (size,) but for its hum, (channels,)."""
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
        """Of what each channel shows about z (size,), by the columns of a root (size, size)."""
        sides = [self._shown(z + column) - self._shown(z - column) for column in columns.T]
        return np.asarray(np.sum(np.square(sides), axis=0) / 4.0)
