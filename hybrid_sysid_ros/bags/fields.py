"""Fields: one number out of a message, by its path, whether the message is an object or a layout of bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hybrid_sysid_ros.bags.signals import Step

NAME_LISTS = ("name", "joint_names")  # where a message keeps the names of its joints


class MissingFieldError(LookupError):
    """The message has not got the field; the text says which part of the path is missing and what is there."""


def field_of(message: Any, steps: Sequence[Step]) -> Any:
    """Follow a path into a message.

    message: an object with attributes, or a mapping with the same names (see layout.Layout).

    Raises:
        MissingFieldError: a step leads nowhere.
    """
    enclosing: list[Any] = []
    node = message
    for step in steps:
        if step.attribute:
            enclosing.append(node)
            node = _attribute(node, step.attribute)
        else:
            node = _entry(node, step, enclosing)
    return node


def has_field(message: Any, name: str) -> bool:
    """Whether a message has a field of that name."""
    return name in message if isinstance(message, dict) else hasattr(message, name)


def _attribute(node: Any, name: str) -> Any:
    if has_field(node, name):
        return node[name] if isinstance(node, dict) else getattr(node, name)
    names = list(node) if isinstance(node, dict) else [key for key in vars(node) if not key.startswith("_")]
    raise MissingFieldError(f"there is no {name}, only {', '.join(names)}")


def _entry(node: Any, step: Step, enclosing: Sequence[Any]) -> Any:
    index = _index_of(step.joint, enclosing) if step.joint else step.index
    if not hasattr(node, "__len__") or isinstance(node, str | dict):
        raise MissingFieldError(f"there is no list to take [{step.joint or step.index}] of")
    if index >= len(node):
        raise MissingFieldError(f"the list has {len(node)} entries, so no [{step.joint or index}]")
    return node[index]


def _index_of(joint: str, enclosing: Sequence[Any]) -> int:
    """Index of a joint in the nearest list of names around the field."""
    for node in reversed(enclosing):
        for key in NAME_LISTS:
            if has_field(node, key):
                names = [str(name) for name in _attribute(node, key)]
                if joint not in names:
                    raise MissingFieldError(f"there is no joint {joint!r}, only {', '.join(names) or 'an empty list'}")
                return names.index(joint)
    raise MissingFieldError(f"the message names no joints: write a number in place of [{joint}]")
