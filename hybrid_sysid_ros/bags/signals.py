"""Signals: the fields of a bag's topics that become the input, output and channels of a record."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built, numbers, read_mapping, refuse_endless, refuse_unknown, section

HOLDS = ("preceding", "following")
_STEP = re.compile(r"\.?(?P<attribute>[A-Za-z_]\w*)|\[(?P<entry>[^\[\]]+)\]")


class Named(Protocol):
    """An input or output with a name and a unit."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...


@dataclass(frozen=True, kw_only=True)
class FieldStep:
    """One step into a message: an attribute by name, a list's entry by number, or a joint's entry by joint name."""

    attribute: str = ""
    index: int = -1
    joint: str = ""


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One number of each message: value = scale * field + offset. Raises UserError for a wrong field or holds."""

    topic: str
    """Name of the topic, absolute or relative to the namespace of the rig."""
    field: str
    """Path into the message: "data", "wrench.force.x", "effort[0]", "position[elbow]" (the entry of the joint of that
    name), "points[0].positions[elbow]"."""
    unit: str = ""
    """Unit of the value after scale and offset, which must be the rig's; "" if it is not stated."""
    scale: float = 1.0
    offset: float = 0.0
    holds: str = "preceding"
    """The interval in which an input's value was applied: "preceding", which ends at the stamp (as a driver reports
    it), or "following", which begins there (a command)."""

    def __post_init__(self) -> None:
        if self.holds not in HOLDS:
            raise UserError(f"signal {self.topic} {self.field}: holds is {self.holds!r}: it needs {' or '.join(HOLDS)}")
        _ = self.steps

    @property
    def steps(self) -> tuple[FieldStep, ...]:
        """The field's path, step by step."""
        return parsed_field(self.field)


@dataclass(frozen=True, kw_only=True)
class Signals:
    """Signals to read from a bag. Outputs share one topic, whose stamps are the record's time."""

    namespace: str
    """Namespace of the rig, of which topics without a leading slash are part."""
    inputs: Mapping[str, Signal]
    """By the names of the system's inputs: the columns of Record.input."""
    outputs: Mapping[str, Signal]
    """By the names of the system's outputs: the columns of Record.output."""
    channels: Mapping[str, Signal] = field(default_factory=dict)
    """Further signals by name, which are left out where a bag lacks them."""
    period: float | None = None
    """Expected sampling time [s]; None accepts that of the bag."""
    source: str = ""
    """The file that declares them, for error messages."""

    def __post_init__(self) -> None:
        if not self.inputs or not self.outputs:
            raise UserError(f"{self.source or 'signals'}: at least one input and one output are needed")
        if len({self.topic(signal) for signal in self.outputs.values()}) > 1:
            raise UserError(f"{self.source or 'signals'}: the outputs must come from one topic, which gives the time")
        if self.period is not None and not self.period > 0:
            raise UserError(f"{self.source or 'signals'}: period is {self.period}: it needs seconds above 0")

    @property
    def input(self) -> tuple[Signal, ...]:
        """The signals of the inputs."""
        return tuple(self.inputs.values())

    @property
    def output(self) -> tuple[Signal, ...]:
        """The signals of the outputs."""
        return tuple(self.outputs.values())

    def topic(self, signal: Signal) -> str:
        """Full name of the signal's topic."""
        if signal.topic.startswith("/"):
            return signal.topic
        return "/" + "/".join(part for part in (self.namespace.strip("/"), signal.topic) if part)

    def ordered(self, inputs: Sequence[Named], outputs: Sequence[Named]) -> Signals:
        """The signals in the order of a rig's inputs and outputs. Raises UserError for other names or units."""
        where, found = self.source or "signals", []
        for kind, signals, variables in (("inputs", self.inputs, inputs), ("outputs", self.outputs, outputs)):
            names = [item.name for item in variables]
            if sorted(signals) != sorted(names):
                raise UserError(f"{where}: signals.{kind} are {', '.join(signals)}, the rig's are {', '.join(names)}")
            for item in variables:
                signal = signals[item.name]
                if signal.unit and signal.unit != item.unit:
                    raise UserError(
                        f"{where}: {kind} {signal.field} is in {signal.unit}, the rig's is in {item.unit}: "
                        f"set the scale that makes it {item.unit}, and its unit to {item.unit}"
                    )
            found.append({name: signals[name] for name in names})
        return dataclasses.replace(self, inputs=found[0], outputs=found[1])

    @classmethod
    def of(cls, content: Mapping[str, Any], namespace: str, where: str, *, given: Given | None = None) -> Signals:
        """Signals from a section "signals". given: inputs, outputs and channels where the section has none.

        Raises UserError where a key is unknown, missing or of the wrong kind.
        """
        where_all = f"{where}: signals"
        refuse_unknown(content, ("inputs", "outputs", "channels", "period"), where_all)
        found = []
        for key, default in zip(("inputs", "outputs", "channels"), given or ({}, {}, {}), strict=True):
            entries = section(content, key, where_all, needed=not default and key != "channels")
            made = {name: built(Signal, value, f"{where}: signals.{key}.{name}") for name, value in entries.items()}
            found.append(made if key in content else dict(default))
        period = content.get("period")
        if period is not None:
            (period,) = numbers(period, f"{where_all}.period", count=1)
        inputs, outputs, channels = found
        return cls(namespace=namespace, inputs=inputs, outputs=outputs, channels=channels, period=period, source=where)

    @classmethod
    def load(cls, path: Path | str) -> Signals:
        """Read the sections "signals" and "namespace" of a YAML file; other sections are ignored.

        Raises UserError for a file that can't be read, and for a key that is unknown, missing or of the wrong kind.
        """
        content = read_mapping(path)
        refuse_endless(content, f"{path}:")
        if not isinstance(content.get("signals"), dict):
            raise UserError(f"{path}: no section 'signals': it names the topics and fields of inputs and outputs")
        return cls.of(content["signals"], str(content.get("namespace") or ""), str(path))


Given = tuple[Mapping[str, Signal], Mapping[str, Signal], Mapping[str, Signal]]
"""Inputs, outputs and channels."""


def parsed_field(text: str) -> tuple[FieldStep, ...]:
    """Steps of a path into a message, such as points[0].positions[elbow].

    Raises UserError for a text that is no such path.
    """
    steps: list[FieldStep] = []
    position = 0
    while position < len(text):
        match = _STEP.match(text, position)
        if match is None:
            break
        attribute, entry = match["attribute"], match["entry"]
        if attribute and bool(steps) != match[0].startswith("."):
            break
        if attribute:
            steps.append(FieldStep(attribute=attribute))
        else:
            steps.append(FieldStep(index=int(entry)) if entry.isdigit() else FieldStep(joint=entry))
        position = match.end()
    if position < len(text) or not steps or not steps[0].attribute:
        raise UserError(f"field {text!r} is no path into a message: write data, effort[0], position[elbow] or a.b.c")
    return tuple(steps)
