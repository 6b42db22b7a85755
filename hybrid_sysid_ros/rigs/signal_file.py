"""A file of signals: columns of a CSV over time, to drive a rig's inputs or to be followed by its outputs."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SUFFIX = ".csv"
LARGEST = 200_000_000
"""Bytes of a file that is read."""
TIME = "time"


@dataclass(frozen=True, kw_only=True, eq=False)
class SignalFile:
    """Signals over time, each sample from its time on."""

    times: Array
    """From 0 on, rising [s], (samples,)."""
    columns: Mapping[str, Array]
    """Values by name, (samples,)."""

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.times[-1])

    def held(self, name: str, times: ArrayLike) -> Array:
        """A column at times of any shape, where each sample holds until the next."""
        index = np.searchsorted(self.times, np.asarray(times, dtype=float) + 1e-9, side="right") - 1
        return np.asarray(self.columns[name][np.maximum(index, 0)])

    def joined(self, names: Sequence[str], times: ArrayLike) -> Array:
        """Columns (..., names) at times of any shape, where lines join the samples."""
        at = np.asarray(times, dtype=float)
        return np.stack([np.interp(at, self.times, self.columns[name]) for name in names], axis=-1)


def is_signal_file(name: str) -> bool:
    """Whether the name of an excitation or a reference is that of a file."""
    return name.lower().endswith(SUFFIX)


def driving_columns(rig: Rig) -> list[tuple[str, str]]:
    """Name and unit of each column that drives an experiment: inputs, or the references of their loops, and behind
    them the commands that the rig's feedback follows.
    """
    loops, feedback, outputs = rig.experiments.loops, rig.experiments.feedback, rig.system.outputs
    found = [(item.name, item.unit) for item in rig.system.inputs]
    for index, output in [
        *((index, loop.output) for index, loop in loops.items()),
        *enumerate(feedback.followed if feedback else (), start=len(found)),
    ]:
        found[index : index + 1] = [(rig.channel("reference", outputs[output].name), rig.display[output].unit)]
    return found


def output_columns(rig: Rig) -> list[tuple[str, str]]:
    """Name and shown unit of each output."""
    return [(item.name, shown.unit) for item, shown in zip(rig.system.outputs, rig.display, strict=True)]


def read_signals(path: Path | str, wanted: Iterable[tuple[str, str]]) -> SignalFile:
    """Read the columns that are wanted, names with units; others are left.

    Raises UserError for a file that is missing, too large or no table, a column that is missing or in another unit, and
    samples that are no numbers or whose times don't rise from 0.
    """
    try:
        if Path(path).stat().st_size > LARGEST:
            raise UserError(f"{path}: is larger than {LARGEST // 1_000_000} MB; write it at a lower rate")
        with Path(path).open(newline="", encoding="utf-8") as file:
            header = [cell.strip() for cell in next(csv.reader(file), [])]
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(
            f"{path}: cannot be read as a CSV file ({getattr(error, 'strerror', None) or error})"
        ) from error
    places = {cell.partition("[")[0].strip(): index for index, cell in enumerate(header)}
    found = {}
    for name, unit in ((TIME, "s"), *wanted):
        if name not in places:
            raise UserError(f"{path}: column {name} [{unit}] is missing: it has {', '.join(header) or 'no header'}")
        given = header[places[name]].partition("[")[2].rstrip("] ")
        if given not in ("", unit):
            raise UserError(f"{path}: column {name} is in {given}; this rig needs it in {unit or '1'}")
        found[name] = np.array([_number(row, places[name], f"{path}: line {k}", name) for k, row in enumerate(rows, 2)])
    times = found.pop(TIME)
    if len(times) < 2 or times[0] != 0.0 or np.any(np.diff(times) <= 0.0):
        raise UserError(f"{path}: column {TIME} must begin at 0 and rise from sample to sample")
    return SignalFile(times=times, columns=found)


def _number(row: Sequence[str], place: int, where: str, name: str) -> float:
    try:
        value = float(row[place])
    except (ValueError, IndexError):
        value = np.nan
    if not np.isfinite(value):
        raise UserError(f"{where}: {name} is {row[place] if place < len(row) else 'missing'!r}: it needs a number")
    return value


def write_signals(path: Path, times: Array, columns: Mapping[tuple[str, str], Array]) -> None:
    """Write columns (samples,) by name and unit as a file that :func:`read_signals` reads."""
    header = ",".join([f"{TIME} [s]", *(f"{name} [{unit}]" for name, unit in columns)])
    np.savetxt(path, np.column_stack([times, *columns.values()]), "%.9g", ",", header=header, comments="")
