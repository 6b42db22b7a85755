"""Signals: which fields of which topics of a bag make the input, output and channels of a record."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.support.configuration_files import configuration_of, load_configuration
from hybrid_sysid_ros.support.errors import UserError

HOLDS = ("preceding", "following")
_STEP = re.compile(r"\.?(?P<attribute>[A-Za-z_]\w*)|\[(?P<entry>[^\[\]]+)\]")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step into a message: an attribute by name, a list's entry by number, or a joint's entry by joint name."""

    attribute: str = ""
    index: int = -1
    joint: str = ""


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One number a message: value = scale * field + offset.

    topic: absolute, or relative to the namespace of the rig.
    field: path into the message: "data", "wrench.force.x", "effort[0]", "position[beam]" (the entry of the joint named
        beam), "points[0].positions[beam]".
    unit: of the value, after scale and offset, which must be the rig's; "" says nothing.
    holds: of an input, the interval that the value was applied in: "preceding" the one that ends at the stamp (what a
        driver reports), "following" the one that begins there (a command).

    Raises UserError when field or holds make no sense.
    """

    topic: str
    field: str
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    holds: str = "preceding"

    def __post_init__(self) -> None:
        if self.holds not in HOLDS:
            raise UserError(f"signal {self.topic} {self.field}: holds is {self.holds!r}: it needs {' or '.join(HOLDS)}")
        _ = self.steps

    @property
    def steps(self) -> tuple[Step, ...]:
        """The field's path, step by step."""
        return parsed_field(self.field)


@dataclass(frozen=True, kw_only=True)
class Signals:
    """What to read from a bag. Outputs share one topic, whose stamps are the record's time.

    namespace: of the rig; topics without a leading slash are in it.
    input, output: the columns of Record.input and Record.output.
    channels: further signals by name, left out where a bag has not got them.
    period: expected sampling time [s]; None takes what the bag has.
    source: the file it came from, for messages to the user.
    """

    namespace: str
    input: tuple[Signal, ...]
    output: tuple[Signal, ...]
    channels: Mapping[str, Signal] = field(default_factory=dict)
    period: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if not self.input or not self.output:
            raise UserError(f"{self.source or 'signals'}: at least one input and one output are needed")
        if len({self.topic(signal) for signal in self.output}) > 1:
            raise UserError(f"{self.source or 'signals'}: the outputs must come from one topic, which gives the time")
        if self.period is not None and not self.period > 0:
            raise UserError(f"{self.source or 'signals'}: period is {self.period}: it needs seconds above 0")

    def topic(self, signal: Signal) -> str:
        """Full name of the signal's topic."""
        if signal.topic.startswith("/"):
            return signal.topic
        return "/" + "/".join(part for part in (self.namespace.strip("/"), signal.topic) if part)

    def check_units(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Raise UserError for a signal that states another unit than those of a rig's inputs and outputs."""
        for kind, signals, units in (("input", self.input, inputs), ("output", self.output, outputs)):
            for signal, unit in zip(signals, units, strict=False):
                if signal.unit and signal.unit != unit:
                    raise UserError(
                        f"{self.source or 'signals'}: {kind} {signal.field} is in {signal.unit}, the rig's is in "
                        f"{unit}: set the scale that makes it {unit}, and its unit to {unit}"
                    )

    @classmethod
    def of_rig(cls, rig: str) -> Signals:
        """Return the signals of a rig that this package configures.

        Raises:
            UserError: there is no such rig.
        """
        return cls.load(configuration_of(rig))

    @classmethod
    def load(cls, path: Path | str) -> Signals:
        """Read section "signals" (and "namespace") of a YAML file. Other sections are for others.

        Raises:
            UserError: no such file, no YAML, a key is unknown, missing or of the wrong kind.
        """
        content = load_configuration(path)
        section = content.get("signals")
        if not isinstance(section, dict):
            raise UserError(f"{path}: no section 'signals': it names the topics and fields of input and output")
        _refuse_unknown(section, ("input", "output", "channels", "period"), f"{path}: signals")
        channels = section.get("channels") or {}
        if not isinstance(channels, dict):
            raise UserError(f"{path}: signals.channels: needs a name and a signal in each line")
        period = section.get("period")
        if period is not None and (isinstance(period, bool) or not isinstance(period, int | float)):
            raise UserError(f"{path}: signals.period is {period!r}: it needs a number of seconds")
        return cls(
            namespace=str(content.get("namespace") or ""),
            input=_signals(section.get("input"), f"{path}: signals.input"),
            output=_signals(section.get("output"), f"{path}: signals.output"),
            channels={str(key): _signal(value, f"{path}: signals.channels.{key}") for key, value in channels.items()},
            period=period,
            source=str(path),
        )


def parsed_field(text: str) -> tuple[Step, ...]:
    """Steps of a path into a message, such as points[0].positions[beam].

    Raises:
        UserError: it is not such a path.
    """
    steps: list[Step] = []
    position = 0
    while position < len(text):
        match = _STEP.match(text, position)
        if match is None:
            break
        attribute, entry = match["attribute"], match["entry"]
        if attribute and bool(steps) != match[0].startswith("."):
            break
        if attribute:
            steps.append(Step(attribute=attribute))
        else:
            steps.append(Step(index=int(entry)) if entry.isdigit() else Step(joint=entry))
        position = match.end()
    if position < len(text) or not steps or not steps[0].attribute:
        raise UserError(f"field {text!r} is no path into a message: write data, effort[0], position[beam] or a.b.c")
    return tuple(steps)


def _signals(value: Any, where: str) -> tuple[Signal, ...]:
    if value is None:
        raise UserError(f"{where}: is missing: it needs a topic and a field")
    if isinstance(value, list):
        return tuple(_signal(entry, f"{where}[{number}]") for number, entry in enumerate(value))
    return (_signal(value, where),)


def _signal(value: Any, where: str) -> Signal:
    if not isinstance(value, dict):
        raise UserError(f"{where}: needs a topic and a field, not {value!r}")
    _refuse_unknown(value, tuple(entry.name for entry in dataclasses.fields(Signal)), where)
    for key in ("topic", "field"):
        if key not in value:
            raise UserError(f"{where}: {key} is missing")
    for key, entry in value.items():
        numeric = key in ("scale", "offset")
        if isinstance(entry, bool) or not isinstance(entry, (int, float) if numeric else str):
            raise UserError(f"{where}.{key} is {entry!r}: it needs {'a number' if numeric else 'text'}")
    try:
        return Signal(**value)
    except UserError as error:
        raise UserError(f"{where}: {error}") from error


def _refuse_unknown(section: Mapping[Any, Any], known: tuple[str, ...], where: str) -> None:
    unknown = [str(key) for key in section if key not in known]
    if unknown:
        raise UserError(f"{where}: unknown key {unknown[0]!r}: known are {', '.join(known)}")
