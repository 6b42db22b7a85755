"""Node commands: the command line that starts a node with its parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.processes import module
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserErrors

COMPOSED = "composed"
"""Name of the node that runs several in one process."""


def command(node: str, values: Mapping[str, Any], *, rig: str = "", namespace: str = "") -> list[str]:
    """The command that starts a node with these parameters; the others have their defaults. rig: the default rig if it
    is empty. Raises UserError where a parameter is unknown or not allowed.
    """
    given = _checked(rig, node, values)
    words = [*module(extensions.node_module(node)), *_naming(rig, namespace)]
    return [*words, *(word for name in given for word in ("-p", f"{name}:={json.dumps(given[name])}"))]


def composed(values: Mapping[str, Mapping[str, Any]], file: Path, *, rig: str, namespace: str) -> list[str]:
    """The command that starts nodes in one process. Raises UserError as command() does."""
    program = module(extensions.node_module(COMPOSED), "--nodes", *values)
    return [*program, *arguments(values, file, rig=rig, namespace=namespace)]


def arguments(values: Mapping[str, Mapping[str, Any]], file: Path, *, rig: str, namespace: str) -> list[str]:
    """Arguments of a program that runs several nodes. Their parameters are written to a file, since ROS has no other
    way to give a parameter to one of several nodes. Raises UserError as command() does.
    """
    file.write_text(parameter_text({node: _checked(rig, node, given) for node, given in values.items()}), "utf-8")
    return [*_naming(rig, namespace), "--params-file", str(file)]


def parameter_text(values: Mapping[str, Mapping[str, Any]]) -> str:
    """A parameter file for nodes by name, in whatever namespace: `-p NODE:NAME:=VALUE` reaches none that is in one."""
    lines = []
    for node, given in values.items():
        lines += [f"/**/{node}:", "  ros__parameters:"]
        lines += [f"    {name}: {json.dumps(value)}" for name, value in given.items()]
    return "\n".join(lines) + "\n"


def _naming(rig: str, namespace: str) -> list[str]:
    return ["--ros-args", "-r", f"__ns:=/{namespace}", "-p", f"rig:={json.dumps(rig)}"]


def _checked(rig: str, node: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Checked values of a node's parameters. Raises UserError for unknown or wrong ones."""
    every, problems = configuration.settings(rigs.load(rig), node, values)
    if every is None or problems:
        raise UserErrors(problems)
    return {name: every[name] for name in values}
