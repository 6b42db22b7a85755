"""A rig for identification alone, made of a record: signals with units and limits, and equations to begin with."""

from __future__ import annotations

import json
import keyword
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import yaml
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from hybrid_sysid_ros.extensions.importing.conversion import row_times
from hybrid_sysid_ros.extensions.importing.grid import clean_stamps, grid_of
from hybrid_sysid_ros.extensions.importing.guessing import INPUTS, OUTPUTS
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile, unit_at_end, words_of
from hybrid_sysid_ros.extensions.importing.mapping import ImportMapping, SignalColumn, TimeColumn
from hybrid_sysid_ros.extensions.importing.time_columns import times_of_column
from hybrid_sysid_ros.extensions.shared.units import named
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.yaml_text import Dumper

ROOM = 0.25
"""Share of an input's span by which its limits lie outside of the record."""
BAND = 0.99
"""Share of the output's variance below the frequency that sets the time scale of the equations."""
PER_PERIOD, FEWEST = 20.0, 300
"""Steps of a fit in a period of that frequency, and fewest steps in the record."""
FARTHEST = 1000.0
"""Bounds of a parameter, in its first value."""
CONSTANTS, DAMPINGS = np.geomspace(1.0 / 60.0, 3.0, 24), np.array([0.05, 0.2, 0.5, 1.0, 2.5])
"""Where the search for an equation begins: time constants in periods of the band, and damping ratios."""
LONGEST, FASTEST = 3.0, 1.5
"""Longest time constant, in records; fastest pole, over a step of the fit."""
MOST = 20_000
"""Samples at the beginning of a record by which the equation is found."""


@dataclass(frozen=True, kw_only=True)
class MadeSignal:
    """An input or output of the rig that is made."""

    name: str
    column: LogColumn
    unit: str
    """Of the rig: SI where the column's unit is known."""
    factor: float
    """Of the rig's unit per unit of the column."""
    values: Array
    """At the samples, (samples,) [unit of the rig]."""


@dataclass(frozen=True, kw_only=True)
class MadeRig:
    """The texts of the files of a rig, and the mapping of its record."""

    system: str
    values: str
    mapping: ImportMapping
    step: float
    """Step and period of fits [s]."""


def roles(columns: Sequence[LogColumn], inputs: Sequence[str], outputs: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the columns that are inputs and outputs: those given, or else those whose names say so."""
    words = {column.name: {*words_of(column.name)} for column in columns if column.name not in (*inputs, *outputs)}
    found_in = list(inputs) or [name for name, its in words.items() if its & {*INPUTS} and not its & {*OUTPUTS}]
    found_out = list(outputs) or [name for name, its in words.items() if its & {*OUTPUTS} and name not in found_in]
    left = [name for name in words if name not in (*found_in, *found_out)]
    if len(left) == 1 and bool(found_in) != bool(found_out):
        (found_out if found_in else found_in).append(left[0])
    return found_in, found_out


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
    grid = grid_of(stamps, f"{file.path}: {first or 'time'}")
    names = _names(chosen)
    signals = []
    for item in chosen:
        column = file.columns[item]
        own = times[item]
        at = clean_stamps(own.seconds * columns[own.column], f"{file.path}: {own.column}") if own.column else stamps
        inside = at.rows < len(columns[item])
        values, times_of = columns[item][at.rows[inside]], at.times[inside]
        known = np.isfinite(values)
        if not known.any() or np.ptp(values[known]) == 0.0:
            raise UserError(
                f"{file.path}: {item} holds no number, or always the same; leave it out (--input, --output)"
            )
        unit = units.get(item, column.unit)
        si, factor = _si(unit)
        sampled = np.interp(grid.times, times_of[known], factor * values[known])
        signals.append(MadeSignal(name=names[item], column=column, unit=si, factor=factor, values=sampled))
    made_inputs, made_outputs = signals[: len(inputs)], signals[len(inputs) :]
    step, band = _time_scale(made_outputs, grid.period)
    mapping = ImportMapping(
        time=time,
        inputs={item.name: _column(item, time, units) for item in made_inputs},
        outputs={item.name: _column(item, time, units) for item in made_outputs},
    )
    return MadeRig(
        system=_system_text(name, file, made_inputs, made_outputs, grid.period, step, band),
        values=_values_text(file, made_inputs, made_outputs, step, units),
        mapping=mapping,
        step=step,
    )


def _column(item: MadeSignal, time: TimeColumn, units: dict[str, str]) -> SignalColumn:
    own = item.column.time if time.column and item.column.time != time.column else ""
    return SignalColumn(column=item.column.name, unit=units.get(item.column.name, item.column.unit), time=own)


def _names(columns: Sequence[str]) -> dict[str, str]:
    """A name for each column that Python and messages take: plain letters, and no unit, since the rig has SI."""
    found = dict[str, str]()
    for column in columns:
        plain = unicodedata.normalize("NFKD", column.removesuffix(f"_{unit_at_end(column)}"))
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


def _time_scale(outputs: Sequence[MadeSignal], period: float) -> tuple[float, float]:
    """Step of fits [s], a multiple of the samples', and the frequency [Hz] below which the outputs vary."""
    samples = len(outputs[0].values)
    bands = []
    for item in outputs:
        power = np.abs(np.fft.rfft(item.values - item.values.mean())) ** 2
        share = np.cumsum(power) / power.sum()
        bands.append(np.fft.rfftfreq(samples, period)[int(np.argmax(share >= BAND))])
    band = min(max(*bands, 2.0 / (samples * period)), 0.3 / period)
    every = max(1, min(int(1.0 / (PER_PERIOD * band * period)), samples // FEWEST))
    return every * period, float(band)


def _equation(output: Array, inputs: Sequence[Array], every: int, step: float, band: float) -> tuple[float, ...]:
    """First values (gains, offset, time constant [s], damping ratio) of T^2 y'' = g u + c - y - 2 d T y': those whose
    simulation is nearest to the record. T and d are searched; gains, offset and initial state follow by least squares
    (variable projection).
    """
    us = [values[: len(values) // every * every].reshape(-1, every).mean(axis=1)[:MOST] for values in inputs]
    y = output[::every][: len(us[0])]

    def solved(point: Array) -> tuple[Array, Array, float, float]:
        """Errors (samples,), numbers that follow, T and d, of log T and log d."""
        damping = float(np.exp(point[1]))
        fastest = damping + np.sqrt(max(damping**2 - 1.0, 0.0))
        constant = max(float(np.exp(point[0])), fastest * step / FASTEST)
        rows = _responses(us, step / constant, damping)
        found = np.asarray(np.linalg.lstsq(rows, y, rcond=None)[0], dtype=np.float64)
        return np.asarray(rows @ found - y), found, float(constant), damping

    beginnings = [np.log([t / band, d]) for t in CONSTANTS for d in DAMPINGS]
    first = min(beginnings, key=lambda point: float(np.sum(solved(point)[0] ** 2)))
    ends = np.log([[CONSTANTS[0] / band, DAMPINGS[0] / 10.0], [LONGEST * step * len(y), 10.0 * DAMPINGS[-1]]])
    best = least_squares(lambda point: solved(point)[0], np.clip(first, ends[0] + 1e-9, ends[1] - 1e-9), bounds=ends)
    _, found, constant, damping = solved(best.x)
    return (*found[: len(us) + 1].tolist(), constant, damping)


def _responses(inputs: Sequence[Array], step: float, damping: float) -> Array:
    """Of y'' = u - y - 2 d y', to each input alone, to an offset and to both initial states, (samples, inputs + 3); the
    inputs are held.
    """
    law = np.array([[0.0, 1.0], [-1.0, -2.0 * damping]]), np.array([[0.0], [1.0]])
    kept, given, *_ = cont2discrete((*law, np.eye(2), np.zeros((2, 1))), step)
    a, b, c, d, e, f = (float(value) for value in (*kept.ravel(), *given.ravel()))
    poles, impulse = [1.0, -a - d, a * d - b * c], np.zeros(len(inputs[0]))
    impulse[0] = 1.0
    driven = [lfilter([0.0, e, b * f - d * e], poles, u) for u in inputs]
    free = [lfilter(numerator, poles, impulse) for numerator in ([1.0, -d], [0.0, b])]
    return np.column_stack([*driven, np.ones(len(impulse)), *free])


def _system_text(
    name: str, file: LogFile, inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], period: float, step: float,
    band: float,
) -> str:  # fmt: skip
    several = len(outputs) > 1 or len(inputs) > 1
    states, fields, rates = [], [], []
    for item in outputs:
        states += [_quoted(f"{item.name} [{item.unit}]"), _quoted(f"{item.name}_rate [{item.unit}/s]")]
        *values, offset, constant, damping = _equation(
            item.values, [u.values for u in inputs], round(step / period), step, band
        )
        size = max(float(np.ptp(item.values)), abs(float(item.values.mean())))
        terms = []
        for k, (u, value) in enumerate(zip(inputs, values, strict=True)):
            field = f"{item.name}_per_{u.name}" if several else "gain"
            terms.append(f"self.{field} * u[{k}]")
            most = FARTHEST * max(abs(value), 1e-3 * size / max(float(np.ptp(u.values)), 1e-12))
            unit = item.unit if u.unit == "1" else f"{item.unit}/({u.unit})"
            fields.append(_field(field, value, -most, most, unit, f"{item.name} per {u.name}, at rest."))
        own = f"{item.name}_" if several else ""
        most = FARTHEST * max(abs(offset), 1e-3 * size)
        shortest, longest = max(constant / FARTHEST, step / 2.0), FARTHEST * constant
        fields += [
            _field(f"{own}offset", offset, -most, most, item.unit, f"{item.name} at rest without an input."),
            _field(f"{own}time_constant", constant, shortest, longest, "s", "1 / the natural frequency [rad/s]."),
            _field(f"{own}damping", damping, damping / FARTHEST, FARTHEST * damping, "1", "Damping ratio."),
        ]
        pull = " + ".join([*terms, f"self.{own}offset"])
        slow = f"2.0 * self.{own}damping * self.{own}time_constant * {item.name}_rate"
        rates += [f"{item.name}_rate", f"({pull} - {item.name} - {slow}) / self.{own}time_constant**2"]
    names = "".join(f"{item.name}, {item.name}_rate, " for item in outputs).removesuffix(", ")
    plain = re.sub(r"[^\w. -]", "_", file.path.name)
    return f'''"""{name}: equations to begin with, made of {plain}; replace them by the physics."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded


@dataclass(frozen=True, kw_only=True)
class {_class_name(name)}(System):
    """T^2 y'' = gain u + offset - y - 2 damping T y', for each output y; T is the time constant."""

    states = ({", ".join(states)})
    inputs = ({", ".join(_quoted(f"{item.name} [{item.unit}]") for item in inputs)},)
    outputs = ({", ".join(f'"{item.name}"' for item in outputs)},)
    stepper = RungeKutta()

    # value, lowest, highest
{"".join(fields)}
    def law(self, x, u):
        """Rates of the states."""
        {names} = x
        return (
            {f",{chr(10)}            ".join(rates)},
        )
'''


def _class_name(rig: str) -> str:
    """The class of a rig's system: OvenHeater of oven_heater."""
    name = "".join(part.capitalize() for part in rig.split("_"))
    return name if name.isidentifier() and not keyword.iskeyword(name) else f"Rig{name}"


def _quoted(text: str) -> str:
    """A text of a file as Python reads it: whatever it holds, it stays a text."""
    return json.dumps(text, ensure_ascii=False)


def _field(name: str, value: float, low: float, high: float, unit: str, words: str) -> str:
    text = f'    """{words}"""\n' if words else ""
    return f"    {name}: float = bounded({value:.4g}, {low:.3g}, {high:.3g}, unit={_quoted(unit)})\n{text}"


def _values_text(
    file: LogFile, inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], step: float, units: dict[str, str]
) -> str:
    sensors, actuators = {}, {}
    for item in outputs:
        shown = (
            {} if item.factor == 1.0 else {"unit": units.get(item.column.name, item.column.unit), "scale": item.factor}
        )
        second = np.abs(np.diff(item.values / item.factor, 2))
        noise = float(np.median(second) / (0.6745 * np.sqrt(6.0)))
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
        {key: value for key, value in content.items() if value}, Dumper=Dumper, sort_keys=False, default_flow_style=None
    )
    return (
        f"# Made of {file.path.name}: a rig for identification alone; docs/guides/rig-file.md describes all sections.\n"
        "# actuators: the record's limits and a quarter more, on their side of 0; put the real ones.\n"
        "# demo: step and period [s] of fits.\n"
        f"# Where the motion ends, say so: travel: {{STATE: [low, high]}}.\n{text}"
    )
