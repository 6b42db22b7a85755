"""System text: the Python of a system that is made of a record, with an equation to begin with for each output."""

from __future__ import annotations

import json
import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.extensions.importing.first_equation import equation_of, is_first_order, late
from hybrid_sysid_ros.extensions.importing.log_file import LogColumn, LogFile
from hybrid_sysid_ros.extensions.shared.wrapping import turn_of
from hybrid_sysid_ros.support.arrays import Array

STABLE = 2.0
"""Largest rate of decay, over a step: from 2.8 on Runge & Kutta's method diverges, so that a lag of first order, for
which a fit makes this rate as large as it can, would end where a network beside it diverges.
"""
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


def system_text(
    name: str, file: LogFile, inputs: Sequence[MadeSignal], outputs: Sequence[MadeSignal], delays: Sequence[int],
    period: float, step: float, band: float,
) -> str:  # fmt: skip
    """The Python of a system with an equation for each output."""
    several, every = len(outputs) > 1 or len(inputs) > 1, round(step / period)
    states, names, fields, rates = [], [], [], []
    us = [late(item.values, delay) for item, delay in zip(inputs, delays, strict=True)]
    for item in outputs:
        *values, offset, constant, damping = equation_of(item.values, us, every, step, band)
        single = is_first_order(constant, damping, step)
        constant = 2.0 * damping * constant if single else constant  # both lags
        states.append(_quoted(f"{item.name} [{item.unit}]"))
        names.append(item.name)
        if not single:
            states.append(_quoted(f"{item.name}_rate [{item.unit}/s]"))
            names.append(f"{item.name}_rate")
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
            _field(
                f"{own}time_constant", constant, shortest, longest, "s",
                "Of the lag." if single else "1 / the natural frequency [rad/s].",
            ),
        ]  # fmt: skip
        pull = " + ".join([*terms, f"self.{own}offset"])
        if single:
            rates.append(f"({pull} - {item.name}) / self.{own}time_constant")
            continue
        fields.append(_field(f"{own}damping", damping, damping / FARTHEST, FARTHEST * damping, "1", "Damping ratio."))
        decay = f"clip(2.0 * self.{own}damping / self.{own}time_constant, 0.0, FASTEST)"
        pulled = f"({pull} - {item.name}) / self.{own}time_constant**2"
        rates += [f"{item.name}_rate", f"{pulled} - {decay} * {item.name}_rate"]
    dead = {f"{u.name}_delay": (u, delay * period) for u, delay in zip(inputs, delays, strict=True) if delay}
    fields += [
        _field(field, seconds, 0.0, 3.0 * seconds, "s", f"By which {u.name} acts later.")
        for field, (u, seconds) in dead.items()
    ]
    declared = ", ".join(f'"{u.name}": "{field}"' for field, (u, _) in dead.items())
    unpacked = ", ".join(names) if len(names) > 1 else f"({names[0]},)"
    second = any(name.endswith("_rate") for name in names if name not in [item.name for item in outputs])
    clipping = f'''from hybrid_sysid_ros.core.mathematics import clip

FASTEST = {STABLE / step:.3g}
"""Largest rate of decay [1/s] that the step of fits simulates stably."""
'''
    plain = re.sub(r"[^\w. -]", "_", file.path.name)
    return f'''"""{name}: equations to begin with, made of {plain}; replace them by the physics."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import RungeKutta, System, bounded
{clipping if second else ""}

@dataclass(frozen=True, kw_only=True)
class {_class_name(name)}(System):
    """T^2 y'' = gain u + offset - y - 2 damping T y', or T y' = gain u + offset - y, for each output y; T is the time
    constant.
    """

    provisional = True  # a guess, which no check of records takes for the physics; delete this line with the guess
    states = ({", ".join(states)}{"," if len(states) == 1 else ""})
    inputs = ({", ".join(_quoted(f"{item.name} [{item.unit}]") for item in inputs)},)
    outputs = ({", ".join(f'"{item.name}"' for item in outputs)},)
{f"    delays = {{{declared}}}{chr(10)}" if dead else ""}    stepper = RungeKutta()

    # value, lowest, highest
{"".join(fields)}
    def law(self, x, u):
        """Rates of the states."""
        {unpacked} = x
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
