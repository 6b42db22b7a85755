"""Conversion: columns of a log file, by a mapping, become records of a rig, and their bags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags import joint_states, joint_trajectories, write_bag
from hybrid_sysid_ros.bags.gaps import MOST_MISSING
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.bags.sampling import JITTER, HeldMean
from hybrid_sysid_ros.bags.series import SECOND
from hybrid_sysid_ros.extensions.importing.grid import (
    SAMPLES_PER_PIECE,
    CleanStamps,
    SampleGrid,
    clean_stamps,
    grid_of,
    known_stamps,
    sampling_stamps,
)
from hybrid_sysid_ros.extensions.importing.log_file import LogFile, check_size
from hybrid_sysid_ros.extensions.importing.mapping import ImportMapping, SignalColumn, further, rig_factor, seconds_of
from hybrid_sysid_ros.extensions.importing.time_columns import other_unit, unit_of_times
from hybrid_sysid_ros.extensions.shared.sentinel import sentinel_of
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of, unwrapped
from hybrid_sysid_ros.library.arguments import given_sampling
from hybrid_sysid_ros.models.plausibility import check_limits, check_travel
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError, UserErrors, counted
from hybrid_sysid_ros.support.files import sha256

START = SECOND
"""Stamp of the first sample [ns]: zero means "no time yet" to ROS."""


def records_of(file: LogFile, mapping: ImportMapping, rig: Rig) -> tuple[list[Record], list[str]]:
    """The records in a log file, one for each piece between long gaps, and what was repaired, a sentence each.

    Raises UserError for a mapping that does not fit the file or the rig, for times that are none, and for values that
    the rig can't have.
    """
    mapping.check(rig, f"{file.path}: mapping")
    return _Conversion(file, mapping, rig, file.read(mapping.columns)).records()


def check_fits(file: LogFile, mapping: ImportMapping, rig: Rig, *, where: Path, stated: bool = False) -> None:
    """Raise UserErrors for a file that lacks a column of a mapping, or whose own units contradict those of the mapping.

    where: what the mapping was made of, for the message. stated: whether the user stated the unit of time just now. A
    ``scale`` of the mapping is the user's word, and stands.
    """
    if lost := [name for name in mapping.columns if name not in file.columns]:
        raise UserError(
            f"{file.path}: has no column {', '.join(lost)}, which {where} has; is it a record of another rig, or of "
            f"another logger? its columns are {', '.join(list(file.columns)[:30])}; give it its own (--mapping)"
        )
    problems = list[str]()
    for name, column in mapping.signals.items():
        own = file.columns[column.column].unit
        if not own or column.scale is not None or column.unit == own:
            continue
        try:
            same = isclose(rig_factor(rig, name, replace(column, unit=own)), rig_factor(rig, name, column))
        except UserError:
            same = False
        if not same:
            problems.append(
                f"{file.path}: {column.column} is in {own} by its own name, and in {column.unit or 'the rig unit'} by "
                f"{where}; give the file its own (--mapping), or the scale of {name} there"
            )
    scored = 0.0 if stated else given_sampling(None, rig).period
    if problem := other_unit(file, mapping.time, scored=scored):
        problems.append(
            f"{file.path}: {problem}, and {mapping.time.unit} by {where}; give the file its own (--mapping), with its "
            "unit (--unit time=UNIT)"
        )
    if problems:
        raise UserErrors(problems)


class _Conversion:
    """One file on its way to records."""

    def __init__(self, file: LogFile, mapping: ImportMapping, rig: Rig, columns: dict[str, Array]) -> None:
        self.file, self.path, self.rig, self.columns = file, file.path, rig, columns
        self.notes: list[str] = []
        signals: dict[str, Any] = {
            kind: self.known(getattr(mapping, kind)) for kind in ("inputs", "outputs", "channels")
        }
        self.mapping = mapping = replace(mapping, **signals)
        self.stamps = dict[str, CleanStamps]()
        outputs = [mapping.outputs[item.name] for item in rig.system.outputs]
        times = [item.time or mapping.time.column for item in outputs]
        rows = [self.stamps_of(time, len(columns[item.column])) for time, item in zip(times, outputs, strict=True)]
        measured = {
            item.column: known_stamps(own, columns[item.column], item.missing)
            for own, item in zip(rows, outputs, strict=True)
        }
        stamps = sampling_stamps(measured, rows[0], str(file.path))
        self.notes += stamps.notes
        self.grid: SampleGrid = grid_of(stamps, self.what(times[0]), scored=given_sampling(None, rig).period)
        check_size(self.path, len(self.grid.times) * (len(mapping.signals) + 1))

    def what(self, column: str) -> str:
        return f"{self.path}: {column or 'time'}"

    def records(self) -> tuple[list[Record], list[str]]:
        measured = self.grid.measured.copy()
        outputs = []
        for item in self.rig.system.outputs:
            values, known = self.sampled(item.name, self.mapping.outputs[item.name])
            outputs.append(values)
            measured &= known
        inputs = [self.held(item.name, self.mapping.inputs[item.name]) for item in self.rig.system.inputs]
        channels = {name: self.sampled(name, column)[0] for name, column in self.mapping.channels.items()}
        known = np.isfinite(np.column_stack(inputs)).all(axis=1)
        if not (measured & known).any():
            raise UserError(f"{self.path}: inputs and outputs are never known at once; do their times begin together?")
        measured &= known
        pieces = list(replace(self.grid, measured=measured).pieces())
        if not pieces:
            raise UserError(
                f"{self.path}: has {measured.sum()} samples, and nowhere {SAMPLES_PER_PIECE} without a long gap; "
                "record it longer, or name other columns"
            )
        found = []
        for number, piece in enumerate(pieces, 1):
            name = self.path.stem if len(pieces) == 1 else f"{self.path.stem}_{number}"
            found.append(self.record(name, piece, measured[piece], inputs, outputs, channels))
        if len(pieces) > 1:
            self.notes.append(
                f"{self.path}: is cut at {counted(len(pieces) - 1, 'long gap')} into {len(pieces)} records"
            )
        notes = [line for stamps in self.stamps.values() for line in stamps.notes]
        return found, list(dict.fromkeys([*notes, *self.notes]))

    def record(
        self, name: str, piece: slice, measured: Any, inputs: list[Array], outputs: list[Array],
        channels: dict[str, Array],
    ) -> Record:  # fmt: skip
        lost = 1.0 - measured.mean()
        if lost > MOST_MISSING:
            raise UserError(
                f"{self.path}: {lost:.1%} of the samples of {name} are missing, and at most {MOST_MISSING:.0%} can be "
                "filled in; name other columns, or record it again"
            )
        record = Record(
            name=name,
            time=self.grid.period * np.arange(piece.stop - piece.start),
            input=_filled(np.column_stack([values[piece] for values in inputs])),
            output=_filled(np.column_stack([values[piece] for values in outputs])),
            channels={key: values[piece] for key, values in channels.items()},
            measured=None if measured.all() else measured,
            source=str(self.path),
            rig=self.rig.name,
        )
        check_limits(record, self.rig)
        check_travel(record, self.rig)
        return record

    def stamps_of(self, column: str, samples: int) -> CleanStamps:
        """Clean times of a column, or of the mapping's period where it is "" ."""
        if column not in self.stamps:
            if column:
                unit = self.seconds_of_times(column)
                self.stamps[column] = clean_stamps(unit * self.columns[column], self.what(column))
            else:
                self.stamps[column] = row_times(self.mapping.time.period, samples)
        return self.stamps[column]

    def seconds_of_times(self, column: str) -> float:
        """Seconds per unit of a column of times: by the mapping, or by the column where its unit is another one."""
        time = self.mapping.time
        own, main = (
            unit_of_times(self.file.columns[name]) if name in self.file.columns else ""
            for name in (column, time.column)
        )
        return time.seconds if own == main else seconds_of(own or "s") or time.seconds

    def values(self, name: str, column: SignalColumn) -> tuple[Array, Array]:
        """Times (rows,) [s] and values (rows,) [unit of the rig] of a signal, where it is known."""
        values = self.columns[column.column]
        time = column.time or self.mapping.time.column
        stamps = self.stamps_of(time, len(values))
        if len(values) != len(self.columns[time] if time else values):
            raise UserError(
                f"{self.path}: {column.column} has {len(values)} values, {time} has {len(self.columns[time])} times; "
                "give the column of its own times (time) in the mapping"
            )
        rows = stamps.rows + column.shift
        inside = (rows >= 0) & (rows < len(values))
        if not inside.any():
            raise UserError(
                f"{self.path}: shift of {name} is {column.shift}, and {column.column} has {len(values)} rows"
            )
        times, found = stamps.times[inside], values[rows[inside]]
        known = np.isfinite(found) & (found != column.missing)
        if not known.any():
            raise UserError(f"{self.path}: column {column.column} holds no number; name another one for {name}")
        if lost := int((~known).sum()):
            self.notes.append(f"{self.path}: {lost} of {len(values)} values of {column.column} are missing")
        times = times[known] - column.delay
        if column.drift:
            times = self.grid.times[0] + (times - self.grid.times[0]) / (1.0 + column.drift)
        found = rig_factor(self.rig, name, column) * found[known] + column.offset
        return times, self.whole(name, column, found) if column.unwrap else found

    def known(self, signals: Mapping[str, SignalColumn]) -> dict[str, SignalColumn]:
        """Signals with the number that stands for a missing value, which the file of the mapping may not have had."""
        found = dict(signals)
        for name, item in signals.items():
            if item.missing is None and (missing := sentinel_of(self.columns[item.column])) is not None:
                found[name] = replace(item, missing=missing)
                self.notes.append(f"{self.path}: {missing:g} in {item.column} is taken for a missing value")
        return found

    def whole(self, name: str, column: SignalColumn, angle: Array) -> Array:
        """An angle (rows,) without wraps. Raises UserError for a signal that is no angle."""
        units = {item.name: item.unit for item in (*self.rig.system.inputs, *self.rig.system.outputs)}
        units |= {more: units[item.name] for item in self.rig.system.outputs for more in further(self.rig, item.name)}
        turn = turn_of(units[name])
        if turn is None:
            raise UserError(f"{self.path}: unwrap of {name}: [{units[name]}] is no unit of an angle; leave it out")
        whole = unwrapped(angle, turn)
        jumps = int(np.count_nonzero(np.diff(np.round((whole - angle)[np.isfinite(angle)] / turn))))
        self.notes.append(
            f"{self.path}: {column.column} comes modulo a turn; {counted(jumps, 'jump')} by a turn taken out (unwrap)"
        )
        return whole

    def snapped(self, name: str, column: SignalColumn) -> tuple[Array, Array]:
        """Times and values of a signal, where stamps that only jitter about the grid's times are these."""
        times, values = self.values(name, column)
        if self.grid.even:
            first, period = self.grid.times[0], self.grid.period
            whole = first + period * np.round((times - first) / period)
            times = np.where(np.abs(times - whole) <= JITTER * period, whole, times)
        return times, values

    def sampled(self, name: str, column: SignalColumn) -> tuple[Array, Any]:
        """A measured signal at the grid's times, and where it is known."""
        times, values = self.snapped(name, column)
        near, period = self.grid.times, self.grid.period
        at = np.searchsorted(times, near)
        away = np.minimum(
            np.abs(near - times[np.maximum(at - 1, 0)]), np.abs(times[np.minimum(at, len(times) - 1)] - near)
        )
        step = max(period, float(np.median(np.diff(times))))
        return np.interp(near, times, values), away <= (0.5 if self.grid.even else 0.75) * step * (1 + 1e-6)

    def held(self, name: str, column: SignalColumn) -> Array:
        """Mean input over the step that follows each of the grid's times; NaN where it is unknown."""
        times, values = self.snapped(name, column)
        stamps = np.round((times - self.grid.times[0]) * 1e9).astype(np.int64)
        stamps, first = np.unique(stamps, return_index=True)
        period = self.grid.period
        edges = np.round(np.append(self.grid.times - self.grid.times[0], len(self.grid.times) * period) * 1e9)
        mean = HeldMean(edges.astype(np.int64), preceding=column.holds == "preceding", margin=int(0.5e9 * period))
        mean.add(stamps, values[first])
        found = np.full(len(self.grid.times), np.nan)
        inside, result = mean.known(), mean.result()
        found[inside] = result[inside]
        return found


def row_times(period: float, samples: int) -> CleanStamps:
    """Times of the rows of a file without times. period: [s]."""
    return CleanStamps(rows=np.arange(samples), times=period * np.arange(samples, dtype=np.float64), notes=[])


def write_records(records: Sequence[Record], rig: Rig, out: Path, *, made_by: str, replace_old: bool) -> list[Path]:
    """Write records as bags with the rig's topics, OUT/NAME each; samples that were not measured are left out.

    Raises UserError where a place can't be written.
    """
    return [
        write_bag(
            out / record.name,
            _topics(record, rig),
            replace=replace_old,
            notes={"made_by": made_by, "source": record.source, "source_sha256": sha256(record.source)},
        )
        for record in records
    ]


def _topics(record: Record, rig: Rig) -> list[Any]:
    """joint_states, whose efforts are the mean inputs since the previous sample, and references that are known."""
    kept = slice(None) if record.measured is None else record.measured
    stamps = (START + np.round(record.time * 1e9).astype(np.int64))[kept]
    names = list(rig.joints.names)
    outputs = [item.name for item in rig.system.outputs]
    second = rig.joints.filtered(outputs, rig.sensors)
    names += second.values()
    fields = {key: np.full((record.samples, len(names)), np.nan) for key in ("position", "velocity", "effort")}
    for index, name in enumerate(outputs):
        joint, key = rig.joints.place(name)
        fields[key][:, names.index(joint)] = record.output[:, index]
        filtered = record.channels.get(rig.channel("filtered", name))
        if filtered is not None and joint in second:
            fields[key][:, names.index(second[joint])] = filtered
    for index, item in enumerate(rig.system.inputs):
        joint, _ = rig.joints.place(item.name)
        fields["effort"][:, names.index(joint)] = np.append(record.input[:1, index], record.input[:-1, index])
    carried: dict[str, Any] = {key: values[kept] for key, values in fields.items() if np.isfinite(values).any()}
    series = [joint_states(f"/{rig.namespace}/joint_states", stamps, names, **carried)]
    references = {name: record.channels.get(rig.channel("reference", name)) for name in outputs}
    places = {name: rig.joints.place(name) for name, values in references.items() if values is not None}
    if places:
        joints = list(dict.fromkeys(joint for joint, _ in places.values()))
        goals = {key: np.full((record.samples, 1, len(joints)), np.nan) for _, key in places.values()}
        for name, (joint, key) in places.items():
            goals[key][:, 0, joints.index(joint)] = references[name]
        given: dict[str, Any] = {"positions" if key == "position" else "velocities": goals[key][kept] for key in goals}
        series.append(joint_trajectories(f"/{rig.namespace}/reference", stamps, joints, times=[0.0], **given))
    return series


def _filled(values: Array) -> Array:
    """Columns in which unknown samples lie on straight lines; they are not measured, and not written."""
    for column in values.T:
        known = np.isfinite(column)
        if not known.all():
            column[:] = np.interp(np.arange(len(column)), np.flatnonzero(known), column[known])
    return values
