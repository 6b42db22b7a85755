"""Guessing: which column of a log file is which signal of a rig, by names and units; what is doubtful is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import SequenceMatcher

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.extensions.importing import mapping
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile, words_of
from hybrid_sysid_ros.extensions.importing.time_columns import time_of, times_of_column
from hybrid_sysid_ros.extensions.shared.sentinel import sentinel_of
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of, wraps_of
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.units import named
from hybrid_sysid_ros.support.errors import UserError, UserErrors

INPUTS = (
    "u", "in", "input", "cmd", "command", "ctrl", "control", "drive", "force", "torque", "voltage", "volt", "pwm",
    "duty", "current", "effort", "actuator", "actuation", "excitation", "motor", "pump", "valve", "throttle", "heater",
    "pedal", "brake", "accelerator", "steering", "elevator", "aileron", "rudder", "thrust", "fan", "stellgröße",
    "stellgroesse", "stellwert", "spannung", "strom", "drehmoment", "kraft", "ventil", "pumpe", "x", "f",
)  # fmt: skip
OUTPUTS = (
    "y", "out", "output", "pos", "position", "angle", "theta", "phi", "q", "speed", "velocity", "vel", "omega", "rate",
    "level", "meas", "measured", "measurement", "sensor", "encoder", "enc", "response", "height", "temperature", "temp",
    "pressure", "distance", "displacement", "altitude", "roll", "pitch", "yaw", "acceleration", "regelgröße",
    "regelgroesse", "messwert", "winkel", "drehzahl", "druck", "temperatur", "geschwindigkeit", "weg",
)  # fmt: skip
ALIKE = (
    {"pos", "position", "x", "q", "displacement"}, {"angle", "theta", "phi", "pos", "position", "q"},
    {"speed", "velocity", "vel", "omega", "v", "w", "rate"}, {"force", "f"}, {"torque", "tau", "moment"},
    {"voltage", "volt", "v", "u"}, {"level", "height", "h"}, {"drive", "command", "cmd", "u", "input"},
    {"current", "i", "amps"}, {"pwm", "duty", "command", "cmd"}, {"input", "u", "in"}, {"output", "y", "out"},
)  # fmt: skip
"""Words for one thing."""
SURE, AHEAD = 0.55, 0.12
"""Score from which a column is taken, and by which it must be ahead of the next one."""


@dataclass(frozen=True, kw_only=True)
class Question:
    """A signal whose column is doubtful."""

    signal: str
    unit: str
    candidates: tuple[str, ...]
    """Columns, the likeliest first."""

    def __str__(self) -> str:
        unit = f" [{self.unit}]" if self.unit else ""
        return f"which column is {self.signal}{unit}: {', '.join(self.candidates[:8]) or 'none is left'}?"


Ask = Callable[[Question], str]
"""Returns the column for a doubtful signal; "" leaves it open."""


def guessed(
    file: LogFile, rig: Rig, *, given: Mapping[str, str], units: Mapping[str, str], period: float, ask: Ask
) -> mapping.ImportMapping:
    """A mapping for a file. given: columns by signal that the user named, "time" among them. units: of columns, by
    signal. period: of the samples [s], 0 where a column has their times.

    Raises UserErrors, a line for each signal that stays open, and for names that are none of the rig's.
    """
    items = [*rig.system.inputs, *rig.system.outputs]
    extra = [name for item in rig.system.outputs for name in mapping.further(rig, item.name)]
    signals = [*(item.name for item in items), *extra, "time"]
    for name in (*given, *units):
        if name not in signals:
            raise UserError(f"{name!r} is no signal of {rig.name}; it has {', '.join(signals)}")
    given = {name: file.column_of(column) for name, column in given.items()}
    for name, column in given.items():
        if column not in file.columns:
            raise UserError(
                f"{file.path}: no column {column!r} for {name}; it has {', '.join(list(file.columns)[:30])}"
            )
    free = [item for item in file.columns.values() if item.name not in given.values()]
    time, free = time_of(file, free, given, units, period)
    found, open_ones = dict(given), list[Question]()
    while left := [item for item in items if item.name not in found]:
        ranked = {item.name: _ranked(item, rig, free, items) for item in left}
        sure = [(scores[0][0], name) for name, scores in ranked.items() if _is_sure(scores)]
        if sure:
            name = max(sure)[1]
            found[name] = ranked[name][0][1].name
        else:
            item = left[0]
            question = Question(
                signal=item.name, unit=item.unit, candidates=tuple(column.name for _, column in ranked[item.name])
            )
            found[item.name] = ask(question)
            if not found[item.name]:
                open_ones.append(question)
        free = [column for column in free if column.name != found.get(name if sure else item.name)]
    problems = [f"{file.path}: {question} name it: --column {question.signal}=COLUMN" for question in open_ones]
    if isinstance(time, str):
        problems.append(time)
    if problems:
        raise UserErrors(problems)
    assert isinstance(time, mapping.TimeColumn)
    if "time" not in given:
        time = times_of_column(file, found[rig.system.outputs[0].name], time, units)

    values = file.read(list(dict.fromkeys(column for name, column in found.items() if name != "time")))

    def column_of(name: str) -> mapping.SignalColumn:
        column = file.columns[found[name]]
        own = column.time if time.column and column.time != time.column else ""
        unit = units.get(name, column.unit)
        rig_unit = next((item.unit for item in items if item.name == name), "")
        its, turn = values[column.name], turn_of(unit or rig_unit)
        wraps = turn is not None and turn_of(rig_unit) is not None and len(wraps_of(its, turn)) > 0
        made = mapping.SignalColumn(column=column.name, unit=unit, time=own, unwrap=wraps, missing=sentinel_of(its))
        # The user's word against the file's is kept as a number, which no header contradicts later.
        contradicted = unit != column.unit != ""
        return replace(made, scale=abs(mapping.rig_factor(rig, name, made))) if contradicted else made

    return mapping.ImportMapping(
        time=time,
        inputs={item.name: column_of(item.name) for item in rig.system.inputs},
        outputs={item.name: column_of(item.name) for item in rig.system.outputs},
        channels={name: column_of(name) for name in extra if name in given},
    )


def _is_sure(scores: Sequence[tuple[float, LogColumn]]) -> bool:
    return bool(scores) and scores[0][0] >= SURE and (len(scores) == 1 or scores[0][0] - scores[1][0] >= AHEAD)


def _ranked(
    item: Variable, rig: Rig, columns: Sequence[LogColumn], items: Sequence[Variable]
) -> list[tuple[float, LogColumn]]:
    """Columns by how likely they are a signal, those left out whose unit can't be."""
    is_input = item in rig.system.inputs
    kind = rig.system.inputs if is_input else rig.system.outputs
    scored = [(_score(item, column, is_input=is_input, alone=len(kind) == 1), column) for column in columns]
    return sorted(((score, column) for score, column in scored if score >= 0.0), key=lambda pair: -pair[0])


def _score(item: Variable, column: LogColumn, *, is_input: bool, alone: bool) -> float:
    """From 0 to 1; negative where the unit can't be."""
    bonus = 0.0
    if column.unit:
        try:
            mapping.ratio(column.unit, item.unit)
            bonus = 0.2
        except UserError:
            if named(column.unit) is not None and named(item.unit) is not None:
                return -1.0
    mine, its = words_of(item.name), words_of(column.name)
    if "".join(mine) == "".join(its):
        return 1.0
    score = 0.45 * SequenceMatcher(None, "".join(mine), "".join(its)).ratio()
    if set(mine) & set(its):
        score = max(score, 0.55 + 0.25 * len(set(mine) & set(its)) / len(set(mine) | set(its)))
    if any(set(mine) & group and set(its) & group for group in ALIKE):
        score = max(score, 0.55)
    words, others = (INPUTS, OUTPUTS) if is_input else (OUTPUTS, INPUTS)
    if alone and set(its) & set(words) and not set(its) & set(others):
        score = max(score, 0.6)
    return min(score + bonus, 0.99)
