"""Definitions: the fields of message types, from the text that a bag keeps of them."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

from rosbags.typesys import get_types_from_idl, get_types_from_msg

from hybrid_sysid_ros.bags.layout import Types
from hybrid_sysid_ros.bags.mcap import DamagedError, Schema
from hybrid_sysid_ros.bags.series import jazzy_types

LONGEST = 1 << 18  # characters: the longest of ROS have some 50 000
_SEPARATOR = "=" * 80 + "\n"
_UNREAD = re.compile(r'"(\\.|[^"\\\n])*"|//[^\n]*|/\*.*?\*/', re.DOTALL)  # texts and comments of IDL
_ANNOTATION = re.compile(r"@\s*[\w:]+\s*\([^()]*\)")


@lru_cache(maxsize=256)
def types_of(schema: Schema) -> Types:
    """The type of a topic and all that it is made of; those of ROS 2 Jazzy where the bag has no definition.

    Raises:
        DamagedError, and what the parsers raise: the text is no definition.
    """
    if not schema.text:
        return jazzy_types().fielddefs
    if len(schema.text) > LONGEST:
        raise DamagedError(f"the definition of {schema.name} has {len(schema.text)} characters")
    if schema.encoding == "ros2msg":
        return get_types_from_msg(schema.text, schema.name)
    if schema.encoding not in ("ros2idl", "omgidl"):
        raise DamagedError(f"the definition of {schema.name} is in {schema.encoding}, not in ROS 2's languages")
    found: dict[str, Any] = {}
    for part in schema.text.split(_SEPARATOR):
        text = part.split("\n", 1)[-1] if part.startswith("IDL: ") else part
        if "(" in _ANNOTATION.sub("", _UNREAD.sub("", text)):  # the parser takes 20 s for ((1))
            raise DamagedError(f"the definition of {schema.name} has an expression in parentheses")
        if text.strip():
            found.update(get_types_from_idl(text))
    return found
