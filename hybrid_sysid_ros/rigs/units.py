"""Units as people write them: symbols and names of the SI, degrees, turns, percent, and rates of all of these."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

TIME, FREQUENCY, COUNT, PERCENT = "s", "Hz", "times", "%"
"""Bases that are no output's."""
LARGEST = 1e12
"""Beyond which no signal of a rig lies, in any unit of the SI."""


class Unit(NamedTuple):
    """A unit: ``factor`` of ``base`` over seconds to the power ``per``; of [deg/s]: pi/180, rad, 1."""

    base: str
    per: int = 0
    factor: float = 1.0

    @property
    def rate(self) -> Unit:
        """The same a second."""
        return self._replace(per=self.per + 1)

    def alike(self, other: Unit) -> bool:
        """Whether the two measure the same."""
        return (self.base, self.per) == (other.base, other.per)


PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6}
PLAIN = Unit("1")
SYMBOLS: Mapping[str, Unit] = {
    **{symbol: Unit(symbol) for symbol in ("rad", "m", "V", "A", "N", "K", "Pa", "W", "J", "N m", "1")},
    "s": Unit(TIME),
    "Hz": Unit(FREQUENCY),
}
"""Which take prefixes."""
OTHERS: Mapping[str, Unit] = {
    **dict.fromkeys(("deg", "degs", "degree", "degrees", "°"), Unit("rad", 0, math.pi / 180.0)),
    **dict.fromkeys(("turn", "turns", "revolution", "revolutions", "rev", "revs"), Unit("rad", 0, 2.0 * math.pi)),
    **dict.fromkeys(("rpm", "RPM"), Unit("rad", 1, 2.0 * math.pi / 60.0)),
    **dict.fromkeys(("kmh", "kph"), Unit("m", 1, 1.0 / 3.6)),
    "mph": Unit("m", 1, 0.44704),
    "bar": Unit("Pa", 0, 1e5),
    "mbar": Unit("Pa", 0, 1e2),
    **dict.fromkeys(("l", "L"), Unit("m^3", 0, 1e-3)),
    **dict.fromkeys(("ml", "mL"), Unit("m^3", 0, 1e-6)),
    "m^3": Unit("m^3"),
    **dict.fromkeys(("ft", "foot", "feet"), Unit("m", 0, 0.3048)),
    **dict.fromkeys(("%", "percent", "pct"), Unit(PERCENT)),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), Unit(TIME, 0, 60.0)),
    **dict.fromkeys(("h", "hour", "hours"), Unit(TIME, 0, 3600.0)),
    **dict.fromkeys(("d", "day", "days"), Unit(TIME, 0, 86400.0)),
    **dict.fromkeys(("sec", "secs"), Unit(TIME)),
    **dict.fromkeys(("times", "time", "cycles", "cycle", "periods", "repetitions"), Unit(COUNT)),
    **dict.fromkeys(("Nm", "N*m"), Unit("N m")),
    "Nmm": Unit("N m", 0, 1e-3),
}
NAMES: Mapping[str, str] = {
    "radian": "rad", "metre": "m", "meter": "m", "volt": "V", "ampere": "A", "amp": "A", "newton": "N", "kelvin": "K",
    "pascal": "Pa", "watt": "W", "joule": "J", "second": "s", "hertz": "Hz",
}  # fmt: skip
"""Names of symbols."""
AXES = {letter: tuple(letter + axis for axis in "abcdq") for letter in "ui"}
"""Voltages and currents of the phases and axes of a machine."""
LETTERS: Mapping[str, frozenset[str]] = {
    "V": frozenset(("voltage", "volt", "u", *AXES["u"], "spannung", "pump", "motor", "heater", "drive", "supply")),
    "A": frozenset(("current", "i", *AXES["i"], "strom")),
    "N": frozenset(("force", "f", "load", "thrust", "kraft")),
    "m": frozenset(("position", "pos", "x", "level", "height", "h", "distance", "displacement", "stroke", "weg")),
    "s": frozenset(("time", "t", "zeit", "timestamp", "elapsed")),
    **dict.fromkeys(("h", "d"), frozenset(("time", "t", "zeit", "elapsed"))),
    "K": frozenset(("temperature", "temp", "temperatur", "t")),
    "W": frozenset(("power", "leistung")),
}
"""Units of one letter, which may be anything: behind these words only they end a name."""
PREFIX_NAMES: Mapping[str, str] = {"milli": "m", "centi": "c", "kilo": "k", "micro": "u", "mega": "M"}


@cache
def words() -> Mapping[str, Unit]:
    """All simple units by what people write; symbols have the case that they have in the SI."""
    found = dict(SYMBOLS)
    for symbol, unit in SYMBOLS.items():
        if symbol != "1":
            found |= {prefix + symbol: unit._replace(factor=factor) for prefix, factor in PREFIXES.items()}
    for name, symbol in NAMES.items():
        for prefix, short in {"": "", **PREFIX_NAMES}.items():
            found |= dict.fromkeys((prefix + name, f"{prefix}{name}s"), found[short + symbol])
    return {**found, **OTHERS}


def named(text: str) -> Unit | None:
    """The unit of a text such as "deg/s", "rpm", "m/s^2" or "counts/s"; None where there is no such unit.

    A name may have another case than the table's, a symbol only where that can't be taken for another one.
    """
    first, *below = text.split("/")
    unit = _simple(first)
    for part in below:
        time, squared = part.removesuffix("^2").removesuffix("²"), part.endswith(("^2", "²"))
        by = _simple(time)
        if unit is None or by is None or by.base != TIME:
            return None
        unit = unit._replace(per=unit.per + 1 + squared, factor=unit.factor / by.factor ** (1 + squared))
    return unit


def factor_of(unit: str, other: str) -> float | None:
    """How many of another unit one is; None where they don't measure the same, or nobody knows one of them."""
    if unit == other:
        return 1.0
    one, by = named(unit), named(other or "1")
    return one.factor / by.factor if one is not None and by is not None and one.alike(by) else None


def of_rig(text: str) -> Unit:
    """The unit of a variable of a rig; one of no table, such as a converter's counts, stands for itself."""
    found = named(text or "1")
    if found is not None:
        return found
    first, *below = text.split("/")
    return Unit(first, len(below))


def _simple(text: str) -> Unit | None:
    known = words()
    if text in known:
        return known[text]
    alike = {known[word] for word in known if word.lower() == text.lower()}
    return alike.pop() if len(alike) == 1 else None
