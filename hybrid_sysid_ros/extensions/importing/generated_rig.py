"""A rig for identification alone, made of a record: signals with units and limits, and equations to begin with."""

from __future__ import annotations

import json
import keyword
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import yaml

from hybrid_sysid_ros.extensions.importing.conversion import row_times
from hybrid_sysid_ros.extensions.importing.first_equation import delays_of, equation_of, late
from hybrid_sysid_ros.extensions.importing.grid import clean_stamps, grid_of
from hybrid_sysid_ros.extensions.importing.guessing import INPUTS, OUTPUTS
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile, without_unit, words_of
from hybrid_sysid_ros.extensions.importing.mapping import ImportMapping, SignalColumn, TimeColumn
from hybrid_sysid_ros.extensions.importing.time_columns import times_of_column
from hybrid_sysid_ros.extensions.shared.sentinel import sentinel_of
from hybrid_sysid_ros.extensions.shared.units import LARGEST, named
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of, unit_of_wraps, unwrapped, wraps_of
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
STABLE = 2.0
"""Largest rate of decay, over a step: from 2.8 on Runge & Kutta's method diverges, so that a lag of first order, for
which a fit makes this rate as large as it can, would end where a network beside it diverges.
"""
PER_PERIOD, FEWEST = 20.0, 300
"""Steps of a fit in a period of that frequency, and fewest steps in the record."""
FARTHEST = 1000.0
"""Bounds of a parameter, in its first value."""


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
    """At the samples, (samples,) [unit of the rig], without wraps."""
    stated: str
    """Unit of the column; that of an angle that wraps is guessed where none is stated."""
    wraps: bool
    """Whether the column has an angle modulo a turn."""
    missing: float | None
    """Number in the column that stands for missing values."""

    @property
    def turns(self) -> bool:
        """Whether it is an angle that goes beyond half a turn to either side, where its sine may act."""
        turn = turn_of(self.unit)
        return turn is not None and float(np.ptp(self.values)) > turn


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


def roles(columns: Sequence[LogColumn], inputs: Sequence[str], outputs: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the columns that are inputs and outputs: those given, or else those whose names say so."""
    words = {column.name: {*words_of(column.name)} for column in columns if column.name not in (*inputs, *outputs)}
    if {"x"} in words.values() and {"f"} in words.values():  # a force and a position, not x and its y
        words = {name: {"position"} if its == {"x"} else its for name, its in words.items()}
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
        missing = sentinel_of(values)
        known = np.isfinite(values) & (values != missing)
        if not known.any() or np.ptp(values[known]) == 0.0:
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
    step, band = _time_scale(made_outputs, grid.period)
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
        system=_system_text(name, file, made_inputs, made_outputs, delays, grid.period, step, band),
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
        plain = unicodedata.normalize("NFKD", without_unit(column))
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
        frequencies = np.asarray(np.fft.rfftfreq(samples, period), dtype=np.float64)
        bands.append(_below(power, frequencies, BAND))
        smooth = np.abs(np.fft.rfft((item.values - item.values.mean()) * np.hanning(samples))) ** 2
        noise = NOISE * float(np.median(smooth[len(smooth) * 4 // 5 :]))
        bands.append(_below(np.maximum(smooth - noise, 0.0) * frequencies**2, frequencies, RATE_BAND))
    band = min(max(*bands, 2.0 / (samples * period)), 0.3 / period)
    every = max(1, min(int(1.0 / (PER_PERIOD * band * period)), samples // FEWEST))
    return float(f"{every * period:.12g}"), float(band)


def _below(power: Array, frequencies: Array, share: float) -> float:
    """The frequency below which a share of the power lies; 0 where there is none."""
    return float(frequencies[int(np.argmax(np.cumsum(power) >= share * power.sum()))])


def _system_text(
    name: str, file: LogFile, inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], delays: Sequence[int],
    period: float, step: float, band: float,
) -> str:  # fmt: skip
    several, every = len(outputs) > 1 or len(inputs) > 1, round(step / period)
    states, fields, rates = [], [], []
    us = [late(item.values, delay) for item, delay in zip(inputs, delays, strict=True)]
    for item in outputs:
        states += [_quoted(f"{item.name} [{item.unit}]"), _quoted(f"{item.name}_rate [{item.unit}/s]")]
        *values, offset, constant, damping = equation_of(item.values, us, every, step, band)
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
        decay = f"clip(2.0 * self.{own}damping / self.{own}time_constant, 0.0, FASTEST)"
        pulled = f"({pull} - {item.name}) / self.{own}time_constant**2"
        rates += [f"{item.name}_rate", f"{pulled} - {decay} * {item.name}_rate"]
    dead = {f"{u.name}_delay": (u, delay * period) for u, delay in zip(inputs, delays, strict=True) if delay}
    fields += [
        _field(field, seconds, 0.0, 3.0 * seconds, "s", f"By which {u.name} acts later.")
        for field, (u, seconds) in dead.items()
    ]
    declared = ", ".join(f'"{u.name}": "{field}"' for field, (u, _) in dead.items())
    names = "".join(f"{item.name}, {item.name}_rate, " for item in outputs).removesuffix(", ")
    plain = re.sub(r"[^\w. -]", "_", file.path.name)
    return f'''"""{name}: equations to begin with, made of {plain}; replace them by the physics."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
from hybrid_sysid_ros.core.mathematics import clip

FASTEST = {STABLE / step:.3g}
"""Largest rate of decay [1/s] that the step of fits simulates stably."""


@dataclass(frozen=True, kw_only=True)
class {_class_name(name)}(System):
    """T^2 y'' = gain u + offset - y - 2 damping T y', for each output y; T is the time constant."""

    provisional = True  # a guess, which no check of records takes for the physics; delete this line with the guess
    states = ({", ".join(states)})
    inputs = ({", ".join(_quoted(f"{item.name} [{item.unit}]") for item in inputs)},)
    outputs = ({", ".join(f'"{item.name}"' for item in outputs)},)
{f"    delays = {{{declared}}}{chr(10)}" if dead else ""}    stepper = RungeKutta()

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


def _values_text(file: LogFile, inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], step: float) -> str:
    sensors, actuators = {}, {}
    for item in outputs:
        shown = {} if item.factor == 1.0 else {"unit": item.stated, "scale": item.factor}
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
        {key: value for key, value in content.items() if value},
        Dumper=Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True,
    )  # fmt: skip
    return (
        f"# Made of {file.path.name}: a rig for identification alone; docs/guides/rig-file.md describes all sections.\n"
        "# actuators: the record's limits and a quarter more, on their side of 0; put the real ones.\n"
        "# demo: step and period [s] of fits.\n"
        f"# Where the motion ends, say so: travel: {{STATE: [low, high]}}.\n{text}"
    )
