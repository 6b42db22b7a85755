"""A rig for identification alone, made of a record: signals with units and limits, and equations to begin with."""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import yaml

from hybrid_sysid_ros.extensions.importing.conversion import row_times
from hybrid_sysid_ros.extensions.importing.first_equation import delays_of
from hybrid_sysid_ros.extensions.importing.grid import clean_stamps, grid_of, known_stamps, sampling_stamps
from hybrid_sysid_ros.extensions.importing.guessing import INPUTS, OUTPUTS
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile, without_unit, words_of
from hybrid_sysid_ros.extensions.importing.mapping import ImportMapping, SignalColumn, TimeColumn
from hybrid_sysid_ros.extensions.importing.system_text import MadeSignal, system_text
from hybrid_sysid_ros.extensions.importing.time_columns import times_of_column
from hybrid_sysid_ros.extensions.shared.sentinel import sentinel_of
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of, unit_of_wraps, unwrapped, wraps_of
from hybrid_sysid_ros.rigs.folder import SYSTEM
from hybrid_sysid_ros.rigs.units import LARGEST, named
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.yaml_text import Dumper

ROOM = 0.25
"""Share of an input's span by which its limits lie outside of the record."""
BAND, RATE_BAND = 0.99, 0.7
"""Shares of the variance of an output and of its rate below the frequency that sets the time scale of the equations:
what integrates moves slowly, and answers fast.
"""
NOISE = 6.0
"""Power of a line that passes for noise, in the median of the fastest lines."""
HELD = 1e-9
"""Change of an input, in its span, below which it is held."""
MOVING, JUMP = 0.1, 0.05
"""Share of the samples at which a signal that is set in steps moves at most; its usual step, in its span, at least."""
NEITHER = {"setpoint", "reference", "ref", "target", "sollwert", "desired", "status", "mode", "id", "index", "counter"}
"""Words of columns that are neither inputs nor outputs."""
PER_PERIOD, FEWEST = 20.0, 300
"""Steps of a fit in a period of that frequency, and fewest steps in the record."""


@dataclass(frozen=True, kw_only=True)
class MadeRig:
    """The texts of the files of a rig, and the mapping of its record."""

    system: str
    values: str
    mapping: ImportMapping
    step: float
    """Step and period of fits [s]."""
    delays: Mapping[str, float]
    """By which inputs act later [s], of those that do."""
    turning: Sequence[str]
    """Outputs that are angles and go beyond half a turn."""


def roles(
    columns: Sequence[LogColumn], inputs: Sequence[str], outputs: Sequence[str], is_stepped: Callable[[str], bool]
) -> tuple[list[str], list[str]]:
    """Names of the columns that are inputs and outputs: those given, or else those whose names say so. Where one kind
    is given, all other columns are of the other kind that do not say something else. Where names say outputs alone,
    inputs are those that stand still between jumps.

    is_stepped: whether a column, by its name, does so.
    """
    words = {column.name: {*words_of(column.name)} for column in columns if column.name not in (*inputs, *outputs)}
    if {"x"} in words.values() and {"f"} in words.values():  # a force and a position, not x and its y
        words = {name: {"position"} if its == {"x"} else its for name, its in words.items()}
    said_in = [name for name, its in words.items() if its & {*INPUTS} and not its & {*OUTPUTS}]
    said_out = [name for name, its in words.items() if its & {*OUTPUTS} and name not in said_in]
    if said_out and not (inputs or said_in):
        said_in = [name for name in words if not words[name] & NEITHER and is_stepped(name)]
        said_out = [name for name in said_out if name not in said_in]
    silent = [name for name in words if name not in (*said_in, *said_out) and not words[name] & NEITHER]
    found_in, found_out = list(inputs) or said_in, list(outputs) or said_out
    if inputs and not outputs:
        found_out = found_out + silent
    elif outputs and not inputs:
        found_in = found_in + silent
    elif len(silent) == 1 and bool(found_in) != bool(found_out):
        (found_out if found_in else found_in).append(silent[0])
    return found_in, found_out


def is_stepped(values: Array) -> bool:
    """Whether a signal stands still between jumps, as inputs do that are set, and no sensor's counts."""
    moved = np.abs(np.diff(values))
    jumps = moved[moved > HELD * np.ptp(values)]
    return 0 < len(jumps) < MOVING * len(values) and float(np.median(jumps)) > JUMP * float(np.ptp(values))


def never_changes(values: Array) -> bool:
    """Whether a column holds no number, or always the same, beside one that stands for missing values."""
    known = values[np.isfinite(values) & (values != sentinel_of(values))]
    return not len(known) or bool(known.min() == known.max())


def made_rig(
    name: str, file: LogFile, time: TimeColumn, inputs: Sequence[str], outputs: Sequence[str], units: dict[str, str]
) -> MadeRig:
    """A rig of these columns. units: of columns, where the file states none or a wrong one.

    Raises UserError for columns that are constant or no numbers, and times that are none.
    """
    chosen = [*inputs, *outputs]
    main, time = time, times_of_column(file, outputs[0], time, units)
    times = {item: times_of_column(file, item, main, units) for item in chosen}
    columns = file.read([*chosen, *(its.column for its in (time, *times.values()) if its.column)])
    first = time.column
    stamps = (
        clean_stamps(time.seconds * columns[first], f"{file.path}: {first}")
        if first
        else row_times(time.period, len(columns[outputs[0]]))
    )
    own_stamps = {
        item: clean_stamps(its.seconds * columns[its.column], f"{file.path}: {its.column}") if its.column else stamps
        for item, its in times.items()
    }
    known_of = {item: known_stamps(own_stamps[item], columns[item], sentinel_of(columns[item])) for item in outputs}
    grid = grid_of(sampling_stamps(known_of, stamps, str(file.path)), f"{file.path}: {first or 'time'}")
    names = _names(chosen)
    signals = []
    for item in chosen:
        column = file.columns[item]
        at = own_stamps[item]
        inside = at.rows < len(columns[item])
        values, times_of = columns[item][at.rows[inside]], at.times[inside]
        missing = sentinel_of(values)
        known = np.isfinite(values) & (values != missing)
        if never_changes(values):
            raise UserError(
                f"{file.path}: {item} holds no number, or always the same; leave it out (--input, --output)"
            )
        if (worst := float(np.abs(values[known]).max())) > LARGEST:
            raise UserError(
                f"{file.path}: {item} has values that no rig reaches, such as {worst:.3g}; make what marks a missing "
                "value an empty cell, or name another column"
            )
        its = values[known]
        unit = units.get(item, column.unit) or unit_of_wraps(its)
        si, factor = _si(unit)
        turn = turn_of(unit)
        wraps = turn is not None and len(wraps_of(its, turn)) > 0
        sampled = np.interp(grid.times, times_of[known], factor * (unwrapped(its, turn) if turn and wraps else its))
        signals.append(
            MadeSignal(
                name=names[item], column=column, unit=si, factor=factor, values=sampled, stated=unit, wraps=wraps,
                missing=missing,
            )
        )  # fmt: skip
    made_inputs, made_outputs = signals[: len(inputs)], signals[len(inputs) :]
    step, band = _time_scale(made_inputs, made_outputs, grid.period)
    delays = delays_of(
        [item.values for item in made_outputs], [item.values for item in made_inputs], round(step / grid.period), step,
        band,
    )  # fmt: skip
    mapping = ImportMapping(
        time=time,
        inputs={item.name: _column(item, time) for item in made_inputs},
        outputs={item.name: _column(item, time) for item in made_outputs},
    )
    return MadeRig(
        system=system_text(name, file, made_inputs, made_outputs, delays, grid.period, step, band),
        values=_values_text(file, made_inputs, made_outputs, step),
        mapping=mapping,
        step=step,
        delays={item.name: k * grid.period for item, k in zip(made_inputs, delays, strict=True) if k},
        turning=[item.name for item in made_outputs if item.turns],
    )


def _column(item: MadeSignal, time: TimeColumn) -> SignalColumn:
    own = item.column.time if time.column and item.column.time != time.column else ""
    return SignalColumn(column=item.column.name, unit=item.stated, time=own, unwrap=item.wraps, missing=item.missing)


def _names(columns: Sequence[str]) -> dict[str, str]:
    """A name for each column that Python and messages take: plain letters, and no unit, since the rig has SI."""
    found = dict[str, str]()
    for column in columns:
        plain = unicodedata.normalize("NFKD", without_unit(column).replace("ß", "ss"))
        plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
        plain = re.sub(r"\W+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", plain), flags=re.ASCII).strip("_").lower()
        plain = f"signal_{plain}" if not plain or plain[0].isdigit() or keyword.iskeyword(plain) else plain
        while plain in found.values() or plain in ("x", "u", "law", "states", "inputs", "outputs", "stepper", "self"):
            plain += "_signal"
        found[column] = plain
    return found


def _si(unit: str) -> tuple[str, float]:
    """The SI unit, and how much of it one is; a unit that nobody knows is kept."""
    found = named(unit) if unit else None
    if found is None or found.factor == 1.0:
        return unit or "1", 1.0
    return found.base + ("" if not found.per else "/s" if found.per == 1 else f"/s^{found.per}"), found.factor


def _time_scale(inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], period: float) -> tuple[float, float]:
    """Step of fits [s], which divides the times for which inputs are held, and the frequency [Hz] of the outputs."""
    samples = len(outputs[0].values)
    bands = []
    for item in outputs:
        power = np.abs(np.fft.rfft(item.values - item.values.mean())) ** 2
        frequencies = np.asarray(np.fft.rfftfreq(samples, period), dtype=np.float64)
        bands.append(_below(power, frequencies, BAND))
        smooth = np.abs(np.fft.rfft((item.values - item.values.mean()) * np.hanning(samples))) ** 2
        noise = NOISE * float(np.median(smooth[len(smooth) * 4 // 5 :]))
        bands.append(_below(np.maximum(smooth - noise, 0.0) * frequencies**2, frequencies, RATE_BAND))
    band = min(max(*bands, 2.0 / (samples * period)), 0.3 / period)
    every = max(1, min(int(1.0 / (PER_PERIOD * band * period)), samples // FEWEST))
    moved = [np.abs(np.diff(item.values)) > HELD * np.ptp(item.values) for item in inputs]
    held = [np.gcd.reduce(np.flatnonzero(item) + 1) for item in moved]
    whole = int(np.gcd.reduce(held))  # samples from one change of the inputs to the next, or a multiple
    fitting = max(k for k in range(1, every + 1) if whole % k == 0)
    every = fitting if whole > 1 and 2 * fitting >= every else every
    return float(f"{every * period:.12g}"), float(band)


def _below(power: Array, frequencies: Array, share: float) -> float:
    """The frequency below which a share of the power lies; 0 where there is none."""
    return float(frequencies[int(np.argmax(np.cumsum(power) >= share * power.sum()))])


def _values_text(file: LogFile, inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], step: float) -> str:
    sensors, actuators = {}, {}
    for item in outputs:
        shown = {} if item.factor == 1.0 else {"unit": item.stated, "scale": item.factor}
        noise = item.noise / item.factor
        sensors[item.name] = {**shown, **({"white_noise": float(f"{noise:.3g}")} if noise > 0.0 else {})}
    for item in inputs:
        low, high, room = item.values.min(), item.values.max(), ROOM * np.ptp(item.values)
        lowest = low - room if low < 0.0 else max(low - room, 0.0)  # a pump that never turned round does not
        highest = high + room if high > 0.0 else min(high + room, 0.0)
        actuators[item.name] = {"low": float(f"{lowest:.3g}"), "high": float(f"{highest:.3g}")}
    content = {
        "step": step, "sensors": {name: value for name, value in sensors.items() if value}, "actuators": actuators,
        "demo": {"step": step, "period": step},
    }  # fmt: skip
    text = yaml.dump(
        {key: value for key, value in content.items() if value},
        Dumper=Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True,
    )  # fmt: skip
    return (
        f"# Made of {file.path.name}: a rig for identification alone; docs/guides/rig-file.md describes all sections.\n"
        "# actuators: the record's limits and a quarter more, on their side of 0; put the real ones.\n"
        f"# demo: step and period [s] of fits; keep the stepper of {SYSTEM}, which suits the step.\n"
        f"# Where the motion ends, say so: travel: {{STATE: [low, high]}}.\n{text}"
    )
