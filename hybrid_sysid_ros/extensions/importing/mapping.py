"""Mapping: which columns of a log file are the signals of a rig, in which unit and at which time; a small YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import yaml

from hybrid_sysid_ros.bags.signals import HOLDS
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.units import SYMBOLS, factor_of, named
from hybrid_sysid_ros.support.errors import UserError, UserErrors, collected
from hybrid_sysid_ros.support.files import write_text
from hybrid_sysid_ros.support.structured import built, read_mapping, refuse_endless, refuse_unknown, section
from hybrid_sysid_ros.support.yaml_text import Dumper

FILE = "import.yaml"
"""Name of a mapping in the folder of a rig."""
KEYS = ("time", "inputs", "outputs", "channels")


def seconds_of(unit: str) -> float | None:
    """Seconds in a unit of time; None for other units."""
    found = named(unit)
    return found.factor if found is not None and found.alike(SYMBOLS["s"]) else None


@dataclass(frozen=True, kw_only=True)
class TimeColumn:
    """The times of the samples: a column, or a period where the file has none. Raises UserError for neither."""

    column: str = ""
    unit: str = "s"
    period: float = 0.0
    """Sampling time [s], where no column has the times."""

    def __post_init__(self) -> None:
        if bool(self.column) == bool(self.period) or self.period < 0.0:
            raise UserError("time needs the name of its column, or the period [s] of the samples")
        if seconds_of(self.unit) is None:
            raise UserError(f"time is in {self.unit!r}: it needs a unit of time, such as s, ms, us or min")

    @property
    def seconds(self) -> float:
        """Seconds per unit."""
        found = seconds_of(self.unit)
        assert found is not None
        return found


@dataclass(frozen=True, kw_only=True)
class SignalColumn:
    """One signal of the rig: value = sign * scale * column + offset. Raises UserError for values that can't be."""

    column: str
    unit: str = ""
    """Of the column's values; "" for that of the rig. ``scale`` follows from both units where it is not given."""
    scale: float | None = None
    """Of the rig's unit per unit of the column."""
    sign: float = 1.0
    """-1 for a column that counts the other way round."""
    offset: float = 0.0
    """Added afterwards [unit of the rig]."""
    shift: int = 0
    """Samples by which the column is late: sample k of the signal stands in row k + shift."""
    delay: float = 0.0
    """Seconds by which its times are late."""
    drift: float = 0.0
    """By which its clock is fast: .001 for a clock that counts 1.001 s in a second."""
    time: str = ""
    """Column with its times, where that is another one than the record's."""
    unwrap: bool = False
    """Whether the column has an angle modulo a turn, which is made whole."""
    missing: float | None = None
    """Number in the column that stands for a missing value."""
    holds: str = "following"
    """Of an input: its value acts from its time on ("following", a command), or until then ("preceding")."""

    def __post_init__(self) -> None:
        if self.holds not in HOLDS:
            raise UserError(f"holds is {self.holds!r}: it needs {' or '.join(HOLDS)}")
        if self.sign not in (-1.0, 1.0):
            raise UserError(f"sign is {self.sign:g}: it needs 1 or -1")
        if self.scale is not None and not self.scale > 0.0:
            raise UserError(f"scale is {self.scale:g}: it needs more than 0; sign: -1 turns a column round")
        if not abs(self.drift) < 0.5:
            raise UserError(f"drift is {self.drift:g}: it needs a share of the time, such as .0005")

    def factor(self, wanted: str, display: str = "", display_scale: float = 1.0) -> float:
        """What the column is multiplied by for the unit that is wanted. display, display_scale: the unit in which the
        rig shows the signal, and the wanted unit per that one.

        Raises UserError where the units don't measure the same.
        """
        return self.sign * (ratio(self.unit, wanted, display, display_scale) if self.scale is None else self.scale)


@dataclass(frozen=True, kw_only=True)
class ImportMapping:
    """Columns of a log file as the signals of a rig."""

    time: TimeColumn
    inputs: Mapping[str, SignalColumn]
    outputs: Mapping[str, SignalColumn]
    channels: Mapping[str, SignalColumn] = field(default_factory=dict)
    """Further signals: "reference" or "filtered" of an output."""

    @property
    def signals(self) -> dict[str, SignalColumn]:
        """All signals by name."""
        return {**self.inputs, **self.outputs, **self.channels}

    @property
    def columns(self) -> list[str]:
        """Names of all columns that are read."""
        times = [self.time.column, *(item.time for item in self.signals.values())]
        return [name for name in dict.fromkeys([*times, *(item.column for item in self.signals.values())]) if name]

    @classmethod
    def load(cls, path: Path) -> ImportMapping:
        """Read a mapping. Raises UserErrors for all that is wrong with it."""
        content, where = read_mapping(path), str(path)
        refuse_endless(content, f"{where}:")
        problems = list[str]()
        with collected(problems):
            refuse_unknown(content, KEYS, where)
        made: dict[str, Any] = {}
        with collected(problems):
            made["time"] = built(TimeColumn, section(content, "time", where, needed=True), f"{where}: time")
        for kind in KEYS[1:]:
            with collected(problems):
                given = section(content, kind, where, needed=kind != "channels")
                made[kind] = {
                    name: built(SignalColumn, value, f"{where}: {kind}.{name}") for name, value in given.items()
                }
        if problems:
            raise UserErrors(problems)
        return cls(**made)

    def save(self, path: Path, comment: str) -> None:
        """Write the mapping as YAML; what is as usual is left out."""
        content: dict[str, Any] = {"time": _brief(self.time)}
        for kind in KEYS[1:]:
            if given := getattr(self, kind):
                content[kind] = {name: _brief(item) for name, item in given.items()}
        text = yaml.dump(
            content, Dumper=Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110
        )
        write_text(path, f"# {comment}\n{text}")

    def check(self, rig: Rig, where: str) -> None:
        """Raise UserErrors where the signals are not those of a rig, or units don't measure the same."""
        problems = list[str]()
        for kind, given, items in (
            ("inputs", self.inputs, rig.system.inputs), ("outputs", self.outputs, rig.system.outputs),
        ):  # fmt: skip
            names = [item.name for item in items]
            if sorted(given) != sorted(names):
                problems.append(
                    f"{where}: the {kind} are {', '.join(given) or 'none'}, and of {rig.name} are {', '.join(names)}; "
                    "it is the mapping of another rig; give --mapping, or delete it to have it guessed"
                )
                continue
            for item in items:
                with collected(problems, f"{where}: {kind}.{item.name}: "):
                    _ = rig_factor(rig, item.name, given[item.name])
        for name, column in self.channels.items():
            with collected(problems, f"{where}: channels.{name}: "):
                _ = rig_factor(rig, name, column)
        if problems:
            raise UserErrors(problems)


def rig_factor(rig: Rig, name: str, column: SignalColumn) -> float:
    """What a column is multiplied by for a signal of a rig.

    Raises UserError for an unknown signal, and where units don't measure the same.
    """
    for item in rig.system.inputs:
        if item.name == name:
            return column.factor(item.unit)
    for item, display in zip(rig.system.outputs, rig.display, strict=True):
        if name == item.name or name in further(rig, item.name):
            return column.factor(item.unit, display.unit, display.scale)
    known = [name for item in rig.system.outputs for name in further(rig, item.name)]
    raise UserError(f"{rig.name} has no such signal; its channels are {', '.join(known)}")


def further(rig: Rig, output: str) -> list[str]:
    """Channels that a record may have of an output: its reference, and its filtered values where a sensor filters."""
    sensor = rig.sensors[[item.name for item in rig.system.outputs].index(output)]
    return [rig.channel(kind, output) for kind in ("reference", *(["filtered"] if sensor.low_pass else []))]


def ratio(given: str, wanted: str, display: str = "", display_scale: float = 1.0) -> float:
    """Number of ``wanted`` in one ``given``. Raises UserError where they don't measure the same."""
    if given in ("", wanted):
        return 1.0
    if given == display:
        return display_scale
    found = factor_of(given, wanted)
    if found is None:
        raise UserError(
            f"{given!r} can't be turned into {wanted or 'a number without a unit'!r}: they don't measure the same, or "
            "one of them is unknown; give the scale"
        )
    return found


def _brief(item: TimeColumn | SignalColumn) -> dict[str, Any]:
    usual = {entry.name: entry.default for entry in fields(item)}
    return {name: value for name, value in asdict(item).items() if value != usual[name] or name == "unit"}
