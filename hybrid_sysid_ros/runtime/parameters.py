"""Parameters of nodes: declared once for all rigs in msgs_config/nodes.yaml, with the values of each rig's rig.yaml.

An empty parameter for a folder means the folder that comes with the package.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.runtime.rig_values import FOLLOWS, RANGES
from hybrid_sysid_ros.support import errors, extensions, manifest
from hybrid_sysid_ros.support.errors import UserError, UserErrors, collected
from hybrid_sysid_ros.support.structured import KINDS, built, numbers, read_mapping, refuse_unknown, section

DECLARATIONS = Path(__file__).parents[1] / "msgs_config" / "nodes.yaml"
Declarations = dict[str, dict[str, dict[str, Any]]]
"""Declarations by node and parameter."""
EACH = ("input", "output", "state")
OPTIONS = {"model": "--model", "policy": "--policy-path", "layers": "--layers"}
"""Options of commands for another folder than the one that comes with the package."""
RENAMED = {"rate_limit": "rates are per second now, not per interval of the MPC: give input_rate, rate_limit / period"}
TRAINED = Path(__file__).parents[1] / "trained"


class NothingShippedError(UserError):
    """The package has no model, policy or layers for a rig."""


def shipped(rig: str, kind: str) -> Path:
    """The folder in the package of a rig's trained model, policy or layers (kind). Raises NothingShippedError where
    there is none.
    """
    folder = TRAINED / rig / kind
    if not folder.is_dir():
        raise NothingShippedError(
            f"no {kind} comes with the package for the rig {rig} ({folder}): give {OPTIONS[kind]}, in Python {kind}"
        )
    return folder


@dataclass(frozen=True, kw_only=True)
class NodeParameter:
    """A parameter of a node: its default, its range or choices, and whether it may change while the node runs.

    Raises UserError when the default is not allowed.
    """

    name: str
    default: Any
    description: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    live: bool = False
    above: str = ""
    """Name of another parameter of the node, which must be smaller."""
    each: str = ""
    """input, output or state: the value is a list with a number for each of the rig's; "": one value."""
    count: int = 0
    """Length of the list; 0 without a rig."""
    ranges: tuple[tuple[float, float], ...] = ()
    """Range of each entry, where the rig tells it; low and high enclose all of them."""

    def __post_init__(self) -> None:
        items = self.default if self.each and isinstance(self.default, list) else [self.default]
        if any(type(item) not in KINDS or (self.each and type(item) not in (int, float)) for item in items):
            raise UserError(f"parameter {self.name}: the default {self.default!r} is of no known kind")
        if self.each not in ("", *EACH):
            raise UserError(f"parameter {self.name}: each is {self.each!r}: choose one of {', '.join(EACH)}")
        if (self.above or math.isfinite(self.low)) and self.kind not in (int, float):
            raise UserError(f"parameter {self.name}: the default {self.default!r} is compared: it needs a number")
        object.__setattr__(self, "default", self.checked(self.default))

    @property
    def kind(self) -> type:
        """bool, int, float or str; for a list the type of its entries."""
        return float if self.each else type(self.default)

    @property
    def comment(self) -> str:
        """The parameter's description with unit, range and rules, in a line."""
        words = [f"{self.description}{f' [{self.unit}]' if self.unit else ''}"]
        words += [f"one for each {self.each}"] if self.each else []
        words += [f"within {self.within}"] if math.isfinite(self.low) else []
        words += [f"one of {', '.join(self.choices)}"] if self.choices else []
        words += [f"more than {self.above}"] if self.above else []
        words += ["live"] if self.live else []
        return "; ".join(words)

    @property
    def within(self) -> str:
        """The range in words, one for each entry where they differ."""
        return ", ".join(dict.fromkeys(f"[{low:g}, {high:g}]" for low, high in self.ranges or [(self.low, self.high)]))

    def checked(self, value: Any) -> Any:
        """The value in the parameter's type (an integer is accepted as a number), a list at its full length. Raises
        UserError for another type or length, and for a value out of range or not among the choices.
        """
        if not self.each:
            return self._one(value, (self.low, self.high))
        if isinstance(value, str | bytes) or not isinstance(value, Sequence):
            value = value.tolist() if hasattr(value, "tolist") else [value]
        if self.count and len(value) not in (1, self.count):
            raise UserError(
                f"parameter {self.name} has {len(value)} numbers: it needs one for each {self.each}, {self.count}"
            )
        items = list(value) * (self.count if self.count and len(value) == 1 else 1)
        ranges = self.ranges or [(self.low, self.high)] * len(items)
        return [self._one(item, limits) for item, limits in zip(items, ranges, strict=True)]

    def _one(self, value: Any, limits: tuple[float, float]) -> Any:
        kind: Any = self.kind
        if kind is float and type(value) is int:
            value = float(value)
        if type(value) is not kind:  # True is no number
            raise UserError(f"parameter {self.name} is {value!r}: it needs {KINDS[kind]}")
        if kind in (int, float) and not (math.isfinite(value) and limits[0] <= value <= limits[1]):
            unit = f" {self.unit}" if self.unit and "," not in self.unit else ""
            raise UserError(f"parameter {self.name} is {value}{unit}: it must be within [{limits[0]:g}, {limits[1]:g}]")
        if self.choices and value not in self.choices:
            raise UserError(f"parameter {self.name} is {value!r}: choose one of {', '.join(self.choices)}")
        return value


def parameters(rig: Rig | str, node: str) -> dict[str, NodeParameter]:
    """Parameters of a node of a rig, by name; their defaults are the rig's values. Raises UserError where there is no
    such rig or node, or some of the rig's values are not allowed.
    """
    rig = rig if isinstance(rig, Rig) else load(rig)
    found, problems = _described(rig, node)
    with collected(problems):
        check_rules(found, _values(found), f"{rig.file}: nodes.{node}: ")
    if problems:
        raise UserErrors(problems)
    return found


def unknown(name: str, known: Mapping[str, Any]) -> UserError:
    """That there is no such parameter, and which there are."""
    return UserError(f"unknown parameter {name}: {RENAMED.get(name) or errors.known(name, known)}")


def settings(rig: Rig, node: str, given: Mapping[str, Any]) -> tuple[dict[str, Any] | None, list[str]]:
    """All values of a node where some are given, by name, and a line for each that is wrong. Those that are against a
    rule are there, None where one is unknown or not allowed. Raises UserError where there is no such node.
    """
    known, wrong = _described(rig, node)
    broken, values = list[str](), _values(known)
    with collected(broken):
        check_rules(known, values, f"{rig.file}: nodes.{node}: ")
    for name, value in given.items():
        with collected(wrong, f"{node}: "):
            if name not in known:
                raise unknown(name, known)
            values[name] = known[name].checked(value)
    if not broken:
        with collected(broken):
            check_rules(known, values, f"{node}: ")
    return None if wrong else values, [*wrong, *broken]


def _described(rig: Rig, node: str) -> tuple[dict[str, NodeParameter], list[str]]:
    """Parameters with the rig's values, and what is wrong with those: they are left out."""
    declared, where = declarations(), str(rig.file)
    if node not in declared:
        raise UserError(f"{DECLARATIONS}: no section nodes.{node}: known are {', '.join(declared)}")
    given = section(rig.content, "nodes", where)
    values, problems = section(given, node, f"{where}: nodes"), list[str]()
    found: dict[str, NodeParameter] = {}
    with collected(problems):
        refuse_unknown(given, tuple(declared), f"{where}: nodes")
    for name in (str(name) for name in values if name not in declared[node]):
        with collected(problems, f"{where}: nodes.{node}: "):
            raise unknown(name, declared[node])
    for name, entry in declared[node].items():
        fitted = {**entry, "unit": _unit(entry, rig), "count": _count(entry, rig)}
        if isinstance(asked := entry.get("range"), str):
            ranges = fitted["ranges"] = RANGES[asked](rig)
            fitted["range"] = [min(low for low, _ in ranges), max(high for _, high in ranges)]
            fitted["default"] = [min(max(entry["default"], low), high) for low, high in ranges]
        found[name] = _parameter(name, fitted, f"{rig.name}: nodes.{node}.{name}")
    chosen = _values(found)
    for name in found.keys() & values.keys():
        with collected(problems, f"{where}: nodes.{node}: "):
            chosen[name] = found[name].checked(values[name])
    for name, rule in ((name, entry["follows"]) for name, entry in declared[node].items() if "follows" in entry):
        if name not in values:
            chosen[name] = FOLLOWS[rule](rig, chosen[name], chosen, _values(_described(rig, "controller")[0]))
    grow(found, chosen, values)
    for name, item in found.items():
        with collected(problems, f"{where}: nodes.{node}: "):
            found[name] = replace(item, default=chosen[name])
    return found, problems


def _values(known: Mapping[str, NodeParameter]) -> dict[str, Any]:
    return {name: item.default for name, item in known.items()}


def grow(known: Mapping[str, NodeParameter], values: dict[str, Any], given: Collection[str]) -> None:
    """Let values that nobody gave, and that must be above another one, grow with that one, in the ratio of their
    defaults.
    """
    for _ in known:  # each may stand above another that grows
        for name, item in known.items():
            if item.above and name not in given and not values[name] > values[item.above]:
                values[name] = item.default * values[item.above] / known[item.above].default


def check_rules(known: Mapping[str, NodeParameter], values: Mapping[str, Any], where: str = "") -> None:
    """Raise UserErrors, each of which begins with where, where values (by name) are against rules that two parameters
    share.
    """
    problems = list[str]()
    for name, item in known.items():
        if item.above and (item.above not in known or isinstance(values[item.above], str | list)):
            problems.append(f"{where}parameter {name}: above is {item.above}, which is no number of the node")
        elif item.above and not values[name] > values[item.above]:
            own = ", its default" if values[name] == item.default else ""
            problems.append(
                f"{where}parameter {name} is {_with_unit(item, values)}{own}: it must be more than {item.above}, "
                f"{_with_unit(known[item.above], values)}"
            )
    if problems:
        raise UserErrors(problems)


def _with_unit(item: NodeParameter, values: Mapping[str, Any]) -> str:
    return f"{values[item.name]:g} {item.unit}".rstrip()


def defaults(rig: Rig | str, node: str) -> dict[str, Any]:
    """The default of each parameter of a node. Raises UserError as parameters() does."""
    return _values(parameters(rig, node))


def parameter_file(rig: Rig | str) -> str:
    """A ROS parameter file of all nodes of a rig, with its default values, for ``--params-file``. Raises UserError as
    parameters() does.
    """
    rig = rig if isinstance(rig, Rig) else load(rig)
    lines = [
        f"# The nodes of {rig.name}: ros2 run hybrid_sysid_ros controller --ros-args --params-file THIS_FILE",
        "# A parameter marked live may be set while a node runs; the others are read when it is configured.",
        "# A line in a node's section takes precedence over -p and /**: delete the lines of values that you give so.",
        "/**:",
        "  ros__parameters:",
        f"    rig: {json.dumps(rig.source)}",
    ]
    for node in declarations():
        lines += [f"/**/{node}:", "  ros__parameters:"]
        for name, item in parameters(rig, node).items():
            lines += [f"    # {item.comment}", f"    {name}: {json.dumps(item.default)}"]
    return "\n".join(lines) + "\n"


def of_file(file: str, node: str) -> dict[str, Any]:
    """Parameters that a ROS parameter file has for a node by its full name."""
    content, found = read_mapping(file) if file else {}, dict[str, Any]()
    for pattern in content:
        if fnmatchcase(node, pattern.replace("/**", "*") if "*" in pattern else f"/{pattern.strip('/')}"):
            found |= section(section(content, pattern, file), "ros__parameters", f"{file}: {pattern}")
    return found


def declarations() -> Declarations:
    """Declarations of nodes.yaml and of the extensions' files. An extension may add parameters to another's node; its
    file is left out where it is wrong or declares an existing parameter.
    """
    return read_declarations()[1]


@cache
def read_declarations() -> tuple[list[Path], Declarations]:
    """The files with declarations of parameters and topics, the trunk's first, and the nodes in them."""
    every = section(read_mapping(DECLARATIONS), "every", str(DECLARATIONS))
    files, found = [DECLARATIONS], _joined(DECLARATIONS, {}, every)
    for name, path in ((item.name, item.declarations) for item in extensions.installed() if item.declarations):
        try:
            found |= _joined(path, found, every)
            files.append(path)
        except UserError as error:
            extensions.leave_out(f"the file of declarations of extension {name}", error)
    return files, found


def _joined(path: Path, known: Declarations, every: Mapping[str, Any]) -> Declarations:
    """Known declarations, extended by those of a file. Raises UserError for declarations that fit no rig."""
    where, content, joined = str(path), read_mapping(path), Declarations()
    refuse_unknown(content, ("nodes", "qos", "topics", *(("every",) if path == DECLARATIONS else ())), where)
    _ = section(content, "topics", where), section(content, "qos", where)
    for node in (nodes := section(content, "nodes", where)):
        here, entries = f"{where}: nodes.{node}", section(nodes, node, where)
        there = {**known.get(node, {}), **every}
        if twice := entries.keys() & there.keys():
            raise UserError(f"{here}.{min(twice)} is declared already: give it another name")
        new = {name: section(entries, name, here, needed=True) for name in entries}
        joined[node] = {**{name: there[name] for name in there if name not in every}, **new, **every}
        found = {name: _parameter(name, entry, f"{here}.{name}") for name, entry in joined[node].items()}
        check_rules(found, {name: item.default for name, item in found.items()}, f"{here}: ")
    return joined


def _count(entry: Mapping[str, Any], rig: Rig) -> int:
    counts = {"input": rig.system.inputs, "output": rig.system.outputs, "state": rig.system.states}
    return len(counts.get(entry.get("each", ""), ()))


def _unit(entry: Mapping[str, Any], rig: Rig) -> str:
    """The declared unit, with the units of the rig's inputs, states or displayed outputs inserted."""
    unit = str(entry.get("unit", ""))
    units = {
        "INPUT": [item.unit for item in rig.system.inputs],
        "OUTPUT": [display.unit for display in rig.display],
        "STATE": [item.unit for item in rig.system.states],
    }
    for word, names in units.items():
        if word in unit:
            names = names if entry.get("each") else names[:1]
            return ", ".join(dict.fromkeys(unit.replace(word, name or "1") for name in names))
    return unit


def _parameter(name: str, entry: Mapping[str, Any], where: str) -> NodeParameter:
    content = {"name": name, **entry}
    limits, follows = content.pop("range", None), content.pop("follows", None)
    if follows not in (None, *FOLLOWS):
        raise UserError(f"{where}.follows is {follows!r}: choose one of {', '.join(FOLLOWS)}")
    if isinstance(limits, str) and limits not in RANGES:
        raise UserError(f"{where}.range is {limits!r}: give lowest and highest value, or one of {', '.join(RANGES)}")
    if isinstance(kind := content.get("choices"), str):
        if kind not in manifest.KINDS:
            raise UserError(f"{where}.choices is {kind!r}: give a list, or a kind of what extensions provide")
        content["choices"] = [*extensions.targets(kind)]
    if limits is not None and not isinstance(limits, str):
        content["low"], content["high"] = numbers(limits, f"{where}.range", count=2)
    return built(NodeParameter, content, where)
