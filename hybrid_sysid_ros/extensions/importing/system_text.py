"""System text: the Python of a system that is made of a record, with an equation to begin with for each output."""

from __future__ import annotations

import json
import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from hybrid_sysid_ros.extensions.importing.first_equation import Equation, equation_of, late
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of
from hybrid_sysid_ros.support.arrays import Array

STABLE = 2.0
"""Largest rate of decay, over a step: from 2.8 on Runge & Kutta's method diverges, so that a lag of first order, for
which a fit makes this rate as large as it can, would end where a network beside it diverges.
"""
ORDERS = (2, 3, 4)
"""Of the differences by which noise is told from motion."""
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
    def noise(self) -> float:
        """Of its sensor, rms [unit of the rig]: the least that differences of some orders leave of a smooth motion."""
        return min(
            float(np.median(np.abs(np.diff(self.values, order))) / (0.6745 * np.sqrt(comb(2 * order, order))))
            for order in ORDERS
        )

    @property
    def turns(self) -> bool:
        """Whether it is an angle that goes beyond half a turn to either side, where its sine may act."""
        turn = turn_of(self.unit)
        return turn is not None and float(np.ptp(self.values)) > turn


def system_text(
    name: str, file: LogFile, inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], delays: Sequence[int],
    period: float, step: float, band: float,
) -> str:  # fmt: skip
    """The Python of a system with an equation for each output."""
    every = round(step / period)
    us = [late(item.values, delay) for item, delay in zip(inputs, delays, strict=True)]
    found = [equation_of(item.values, us, every, step, band, item.noise) for item in outputs]
    several, taken = len(outputs) > 1 or len(inputs) > 1, [item.name for item in outputs]
    laws = list[_LawText]()
    for item, equation in zip(outputs, found, strict=True):
        laws.append(_law_of(item, inputs, equation, step, taken, several=several))
        taken += laws[-1].names
    fields = [field for law in laws for field in law.fields]
    dead = {f"{u.name}_delay": (u, delay * period) for u, delay in zip(inputs, delays, strict=True) if delay}
    fields += [
        _field(field, seconds, 0.0, 3.0 * seconds, "s", f"By which {u.name} acts later.")
        for field, (u, seconds) in dead.items()
    ]
    declared = ", ".join(f'"{u.name}": "{field}"' for field, (u, _) in dead.items())
    states = [state for law in laws for state in law.states]
    direct = any(equation.form.direct for equation in found)
    lines = [f"{_unpacked([state for law in laws for state in law.names])} = x"]
    lines += [f"{_unpacked([item.name for item in outputs])} = self.output(x, u)"] if direct else []
    lines += [line for law in laws for line in law.lines]
    output = f"""
    def output(self, x, u):
        \"\"\"Readings of the sensors.\"\"\"
        {_unpacked([state for law in laws for state in law.names])} = x
        return (
            {f",{chr(10)}            ".join(law.output for law in laws)},
        )
"""
    clipping = f'''from hybrid_sysid_ros.core.mathematics import clip

FASTEST = {STABLE / step:.3g}
"""Largest rate of decay [1/s] that the step of fits simulates stably."""
'''
    plain = re.sub(r"[^\w. -]", "_", file.path.name)
    return f'''"""{name}: equations to begin with, made of {plain}; replace them by the physics."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
{clipping if any(equation.form.order == 2 for equation in found) else ""}

@dataclass(frozen=True, kw_only=True)
class {_class_name(name)}(System):
    """T^2 y'' = gain u + offset - y - 2 damping T y', or T y' = gain u + offset - y, for each output y; T is the time
    constant. Where the record shows it, an input moves y' or y at once, too.
    """

    provisional = True  # a guess, which no check of records takes for the physics; delete this line with the guess
    states = ({", ".join(states)}{"," if len(states) == 1 else ""})
    inputs = ({", ".join(_quoted(f"{item.name} [{item.unit}]") for item in inputs)},)
    outputs = ({", ".join(_quoted(f"{item.name} [{item.unit}]" if direct else item.name) for item in outputs)},)
{f"    delays = {{{declared}}}{chr(10)}" if dead else ""}    stepper = RungeKutta()

    # value, lowest, highest
{"".join(fields)}
    def law(self, x, u):
        """Rates of the states."""
        {f"{chr(10)}        ".join(lines)}
        return (
            {f",{chr(10)}            ".join(rate for law in laws for rate in law.rates)},
        )
{output if direct else ""}'''


@dataclass(frozen=True, kw_only=True)
class _LawText:
    """What one output adds to the text of a system."""

    names: Sequence[str]
    """Of its states."""
    states: Sequence[str]
    """As they are declared."""
    fields: Sequence[str]
    lines: Sequence[str]
    """Before the rates."""
    rates: Sequence[str]
    output: str


def _law_of(
    item: MadeSignal, inputs: Sequence[MadeSignal], equation: Equation, step: float, taken: Sequence[str], *,
    several: bool,
) -> _LawText:  # fmt: skip
    """The text of an equation. taken: names that its states must not have; several: parameters are called by it."""
    form, y, constant = equation.form, item.name, equation.constant
    first = _new(f"{y}_lagging", taken) if form.direct else y
    names = [first, *([_new(f"{y}_rate", taken)] if form.order == 2 else [])]
    size = max(float(np.ptp(item.values)), abs(float(item.values.mean())))
    fields = list[str]()

    def per_input(kind: str, values: Array, unit: str, least: float, words: str) -> str:
        terms = []
        for k, (u, value) in enumerate(zip(inputs, values.tolist(), strict=True)):
            field = f"{y}{kind}_per_{u.name}" if several else f"gain{kind}"
            most = FARTHEST * max(abs(value), least / max(float(np.ptp(u.values)), 1e-12))
            per = unit if u.unit == "1" else f"{unit}/({u.unit})"
            fields.append(_field(field, value, -most, most, per, f"{words.format(y, u.name)}."))
            terms.append(f"self.{field} * u[{k}]")
        return " + ".join(terms)

    own = f"{y}_" if several else ""
    pull = f"{per_input('', equation.gains, item.unit, 1e-3 * size, '{} per {}, at rest')} + self.{own}offset - {y}"
    most = FARTHEST * max(abs(equation.offset), 1e-3 * size)
    shortest, longest = max(constant / FARTHEST, step / 2.0), FARTHEST * constant
    fields += [
        _field(f"{own}offset", equation.offset, -most, most, item.unit, f"{y} at rest without an input."),
        _field(
            f"{own}time_constant", constant, shortest, longest, "s",
            "Of the lag." if form.order == 1 else "1 / the natural frequency [rad/s].",
        ),
    ]  # fmt: skip
    lines, rates = list[str](), [f"({pull}) / self.{own}time_constant"]
    if form.order == 2:
        damping = equation.damping
        fields.append(_field(f"{own}damping", damping, damping / FARTHEST, FARTHEST * damping, "1", "Damping ratio."))
        rate = names[1]
        if form.by_rate:
            unit, least = f"{item.unit}/s", 1e-3 * size / constant
            moved = per_input("_of_change", equation.rates, unit, least, "Rate of {} at once, per {}")
            rate = _new(f"{first}_change", taken)
            lines.append(f"{rate} = {names[1]} + {moved}")
        decay = f"clip(2.0 * self.{own}damping / self.{own}time_constant, 0.0, FASTEST)"
        rates = [rate, f"({pull}) / self.{own}time_constant**2 - {decay} * {rate}"]
    shares = per_input("_at_once", equation.shares, item.unit, 1e-3 * size, "{} per {}, at once") if form.direct else ""
    return _LawText(
        names=names,
        states=[_quoted(f"{name} [{item.unit}{unit}]") for name, unit in zip(names, ("", "/s"), strict=False)],
        fields=fields, lines=lines, rates=rates, output=f"{first} + {shares}" if shares else first,
    )  # fmt: skip


def _new(name: str, taken: Sequence[str]) -> str:
    """A name that is not taken."""
    return name if name not in taken else _new(f"{name}_state", taken)


def _unpacked(names: Sequence[str]) -> str:
    """Names that a tuple is taken apart into."""
    return ", ".join(names) if len(names) > 1 else f"({names[0]},)"


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
