"""YAML of plain data: read within limits of size, depth and number, and written so that it is read unchanged."""

from __future__ import annotations

import re
from collections.abc import Hashable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

LARGEST = 1 << 20
"""Most bytes of a file."""
DEEPEST = 32
"""Most levels of lists and mappings."""
MOST = 100_000
"""Most values, each counted as often as aliases repeat it."""
LONGEST = 100
"""Most characters of a number."""

_PLAIN = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float", "str", "seq", "map", "merge"))
_Parser: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's where PyYAML has it: ten times as fast


class TextError(ValueError):
    """A text is no YAML of plain data, or beyond the limits; the message has the reason, and the line where known."""


class _Loader(_Parser):  # type: ignore[misc]
    """Loader of plain data, without dates, bytes or sets, which YAML knows and no file here needs."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        if node.tag not in _PLAIN:
            raise _wrong(f"tag {node.tag!r} is none of plain data", node)
        if node.tag in _PLAIN[2:4] and len(node.value) > LONGEST:
            raise _wrong(f"a number of {len(node.value)} characters", node)
        value = super().construct_object(node, deep=deep)
        if isinstance(value, int) and abs(value) >= 1 << 64:
            raise _wrong("a whole number of more than 64 bits", node)
        return value


class Dumper(yaml.SafeDumper):
    """Dumper of text that :func:`parsed` reads unchanged."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in known if tag in _PLAIN]
    for first, known in _Parser.yaml_implicit_resolvers.items()
}
for _kind in (_Loader, Dumper):  # 1e9 and 1.0e9 are numbers to everybody but YAML 1.1, which wants 1.0e+9
    _kind.add_implicit_resolver(
        "tag:yaml.org,2002:float", re.compile(r"[-+]?(\.\d+|\d+(\.\d*)?)[eE][-+]?\d+$"), list("-+.0123456789")
    )


def read(path: Path) -> Any:
    """Plain data of a YAML file. Raises OSError where it can't be read. Raises TextError as its docstring says."""
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise TextError(f"is larger than {LARGEST >> 20} MiB, which no such file needs")
    try:
        return parsed(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise TextError("is no text file, so no YAML") from error


def parsed(text: str) -> Any:
    """Plain data of a YAML text. Raises TextError."""
    try:
        _check(text)
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or "unreadable").split())
        raise TextError(f"is no valid YAML{where} ({problem[:200]})") from error
    except Exception as error:  # an explicit tag on what is none of its kind, as in !!int abc
        raise TextError(f"is no valid YAML ({type(error).__name__} in a value)") from error


@dataclass
class _Level:
    """A list or mapping that is open."""

    anchor: str | None
    before: int
    """Values before it."""
    keys: set[Hashable] | None
    """Of a mapping, those it has so far."""
    parts: int = field(default=0)
    """Nodes that it has so far: a mapping's even ones are keys."""


def _check(text: str) -> None:
    """Walk through a text without building anything. Raises YAMLError for what is beyond the bounds, a key that a
    mapping has twice, and an alias inside of what it stands for.
    """
    count, levels, anchors = 0, list[_Level](), dict[str, int]()
    for event in yaml.parse(text, Loader=_Parser):
        if isinstance(event, yaml.CollectionEndEvent):
            level = levels.pop()
            if level.anchor:
                anchors[level.anchor] = count - level.before
            continue
        if not isinstance(event, yaml.NodeEvent):
            continue
        if levels:
            _take(levels[-1], event)
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in anchors:
                raise _wrong(f"alias {event.anchor!r} stands for nothing before it", event)
            count += anchors[event.anchor]
        else:
            count += 1
        if isinstance(event, yaml.CollectionStartEvent):
            keys = set[Hashable]() if isinstance(event, yaml.MappingStartEvent) else None
            levels.append(_Level(anchor=event.anchor, before=count - 1, keys=keys))
        elif isinstance(event, yaml.ScalarEvent) and event.anchor:
            anchors[event.anchor] = 1
        if len(levels) > DEEPEST:
            raise _wrong(f"more than {DEEPEST} levels", event)
        if count > MOST:
            raise _wrong(f"more than {MOST} values", event)


def _take(level: _Level, event: yaml.NodeEvent) -> None:
    """Note a node of a list or mapping. Raises YAMLError for a key that is there already."""
    is_key = level.keys is not None and level.parts % 2 == 0
    level.parts += 1
    if level.keys is not None and is_key and isinstance(event, yaml.ScalarEvent):
        if event.value in level.keys:
            raise _wrong(f"key {event.value!r} is there twice: keep one", event)
        level.keys.add(event.value)


def _wrong(problem: str, where: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=where.start_mark)
