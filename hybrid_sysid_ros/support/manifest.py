"""A manifest: what an extension adds, by name, as plain data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from hybrid_sysid_ros.support import errors
from hybrid_sysid_ros.support.errors import UserError

KINDS = (
    "sections", "report", "companions", "demos", "controllers", "pictures", "structures", "blocks", "solvers",
    "problems", "estimators", "policies", "exporters", "descriptions", "drawings", "record_checks", "record_remarks",
    "training_notes", "use_checks", "loop_checks", "wrappers", "criteria", "inspections", "comparisons",
    "pages", "figures", "loops",
)  # fmt: skip
"""Kinds of objects that an extension may provide."""


@dataclass(frozen=True, kw_only=True)
class Extension:
    """A manifest of an extension's additions by name. docs/extend.md describes each kind.

    Raises UserError for a field of another type, and for an unknown kind.
    """

    name: str
    summary: str
    commands: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """By its words, such as "say" or "rig layouts": a module with a function ``command``, and a summary of one line."""
    nodes: Mapping[str, str] = field(default_factory=dict)
    """ROS 2 nodes by name: a module with a function ``main``."""
    declarations: Path | None = None
    """YAML file of the form of msgs_config/nodes.yaml: parameters of its nodes, further ones of others, and topics."""
    provides: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """By kind and name, an object as "module:attribute"."""

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self)).items():
            if not _fits(value := getattr(self, name), hint):
                raise UserError(f"its {name} is {value!r}: it needs {self.__annotations__[name]}")
        for kind in set(self.provides) - set(KINDS):
            raise UserError(f"its provides has an unknown kind {kind!r}: {errors.known(kind, KINDS)}")

    def claims(self) -> Iterator[tuple[str, str]]:
        """Kinds and names that no other extension may have."""
        yield from (("command", words) for words in self.commands)
        yield from (("node", name) for name in self.nodes)
        yield from ((kind, name) for kind, names in self.provides.items() for name in names)


def _fits(value: Any, hint: Any) -> bool:
    """Whether plain data has a type: a class, or a tuple or mapping of such."""
    kinds, kind = get_args(hint), get_origin(hint)
    if kind is tuple:
        return isinstance(value, tuple) and len(value) == len(kinds) and all(map(_fits, value, kinds))
    if kind is Mapping:
        return isinstance(value, Mapping) and all(_fits(item, tuple[kinds]) for item in value.items())  # type: ignore[valid-type]
    return isinstance(value, hint)
