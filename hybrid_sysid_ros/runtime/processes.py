"""Processes: the command line, environment and priority of a node's process."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.support import extensions
from hybrid_sysid_ros.support.errors import UserErrors

COMPOSED = "composed"
"""Name of the node that runs several in one process."""
REAL_TIME_PRIORITY = 10  # of the loop's processes: above every ordinary one, below what a system keeps for itself
LISTENING_PRIORITY = 1
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
"""Variables that are 1 unless the user says otherwise: a loop's matrices are too small for more threads."""
IN_LOOP = ("plant", "estimator", "controller")


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


def module(name: str, *arguments: str) -> list[str]:
    """The command that runs a module that needs ROS, by its full name."""
    return [sys.executable, "-m", name, *arguments]


def _naming(rig: str, namespace: str) -> list[str]:
    return ["--ros-args", "-r", f"__ns:=/{namespace}", "-p", f"rig:={json.dumps(rig)}"]


def _checked(rig: str, node: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Checked values of a node's parameters. Raises UserError for unknown or wrong ones."""
    every, problems = configuration.settings(rigs.load(rig), node, values)
    if every is None or problems:
        raise UserErrors(problems)
    return {name: every[name] for name in values}


def permitted_priority() -> int:
    """REAL_TIME_PRIORITY where this process may use it (as root, or by `ulimit -r`), else 0."""
    try:
        before = os.sched_getscheduler(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except (OSError, AttributeError):  # not permitted, or no Linux
        return 0
    return REAL_TIME_PRIORITY


def priority_of(node: str, loop: int) -> int:
    """Real-time priority of a node, where the loop's nodes have the priority `loop`.

    On one computer, publishers and subscribers of a message share a lock. All nodes that subscribe to the loop's topics
    have a real-time priority, so that no ordinary process can delay the loop while it holds the lock.
    """
    return loop if node in IN_LOOP else min(loop, LISTENING_PRIORITY)


def environment(domain: int | None = None) -> dict[str, str]:
    """The environment of the nodes. Variables that the user has set stay."""
    found = dict(os.environ)
    if domain is not None:
        found["ROS_DOMAIN_ID"] = str(domain)
    found.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name in THREADS:
        found.setdefault(name, "1")
    if "HOME" not in found:
        found.setdefault("ROS_LOG_DIR", str(Path(tempfile.gettempdir()) / "ros_log"))
    return found
