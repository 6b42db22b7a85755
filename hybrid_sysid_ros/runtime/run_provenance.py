"""Provenance of a run, kept in its bag: the parameters of each node, and the folders that they name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.parameters import shipped
from hybrid_sysid_ros.support import yaml_text
from hybrid_sysid_ros.support.errors import UserError

PARAMETERS = "parameters.yaml"
FOLDERS = {"model": "model", "policy": "policy_path"}
"""Parameters that name folders, by their content; an empty one means the folder in the package."""


def parameter_attachment(node: str, values: Mapping[str, Any]) -> dict[str, bytes]:
    """The parameters of a node as an attachment of a bag, NODE/parameters.yaml: a parameter file of ROS."""
    content = {"/**": {"ros__parameters": dict(values)}}
    text = yaml.dump(content, Dumper=yaml_text.Dumper, sort_keys=False, allow_unicode=True)
    return {f"{node}/{PARAMETERS}": text.encode()}


def folders(node: str, values: Mapping[str, Any]) -> dict[str, Path]:
    """The folders that a node with these parameters reads, by the names of their attachments, NODE/model and
    NODE/policy. Raises UserError where the package lacks a folder that the parameters need.
    """
    found = {}
    for kind, name in FOLDERS.items():
        if name in values and (kind, values.get("policy")) != ("policy", "exact"):
            found[f"{node}/{kind}"] = Path(values[name] or shipped(rigs.load(values["rig"]).name, kind))
    return found


def parameters(found: Mapping[str, bytes], node: str) -> dict[str, Any]:
    """The parameters of a node from a bag's attachments, {} where there are none. Raises UserError where they are
    unreadable.
    """
    name = f"{node}/{PARAMETERS}"
    try:
        content = yaml_text.parsed(found.get(name, b"{}").decode("utf-8")) or {"/**": {"ros__parameters": {}}}
        return {str(key): value for key, value in content["/**"]["ros__parameters"].items()}
    except (yaml_text.TextError, UnicodeDecodeError, LookupError, TypeError, AttributeError) as error:
        raise UserError(f"the bag's attachment {name} is no parameter file of ROS ({error})") from error
