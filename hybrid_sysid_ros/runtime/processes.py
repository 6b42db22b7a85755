"""Processes: how a node is started: its command line, its environment and its priority."""

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
"""Node of several in one process."""
REAL_TIME_PRIORITY = 10  # of the loop's processes: above every ordinary one, below what a system keeps for itself
LISTENING_PRIORITY = 1
IN_LOOP = ("plant", "estimator", "controller")


def command(node: str, values: Mapping[str, Any], *, rig: str = "", namespace: str = "") -> list[str]:
    """Command that starts a node with these parameters; the others have their defaults. rig: by default the one that is
    meant where none is named. Raises UserError where a parameter is unknown or not allowed.
    """
    given = _checked(rig, node, values)
    words = _beginning(node, rig=rig, namespace=namespace)
    return [*words, *(word for name in given for word in ("-p", f"{name}:={json.dumps(given[name])}"))]


def composed(values: Mapping[str, Mapping[str, Any]], file: Path, *, rig: str, namespace: str) -> list[str]:
    """Command that starts nodes with their parameters in one process; they are written to a file, for ROS has no other
    way to give a parameter to one of several. Raises UserError: see command().
    """
    lines = []
    for node, given in values.items():
        lines += [f"/**/{node}:", "  ros__parameters:"]
        lines += [f"    {name}: {json.dumps(value)}" for name, value in _checked(rig, node, given).items()]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = _beginning(COMPOSED, "--nodes", *values, rig=rig, namespace=namespace)
    return [*words, "--params-file", str(file)]


def module(name: str, *arguments: str) -> list[str]:
    """Command that runs a module, by its full name, that needs ROS and is no node of a rig itself."""
    return [sys.executable, "-m", name, *arguments]


def _beginning(node: str, *arguments: str, rig: str, namespace: str) -> list[str]:
    words = [*module(extensions.node_module(node), *arguments), "--ros-args"]
    return [*words, "-r", f"__ns:=/{namespace}", "-p", f"rig:={json.dumps(rig)}"]


def _checked(rig: str, node: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """The values as the parameters of a node have them."""
    every, problems = configuration.settings(rigs.load(rig), node, values)
    if every is None or problems:
        raise UserErrors(problems)
    return {name: every[name] for name in values}


def permitted_priority() -> int:
    """REAL_TIME_PRIORITY where this process may have one (as root, or by `ulimit -r`), else 0."""
    try:
        before = os.sched_getscheduler(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except (OSError, AttributeError):  # not permitted, or no Linux
        return 0
    return REAL_TIME_PRIORITY


def priority_of(node: str, loop: int) -> int:
    """Real-time priority of a node where that of the loop's is `loop`.

    Whoever hears a message on this computer shares a lock with whoever sends it. So that no ordinary process keeps one
    that holds it from going on, and the loop waiting, all that hear the loop come before the ordinary ones.
    """
    return loop if node in IN_LOOP else min(loop, LISTENING_PRIORITY)


def environment(domain: int | None = None) -> dict[str, str]:
    """Environment of the nodes. What the user has set stays."""
    found = dict(os.environ)
    if domain is not None:
        found["ROS_DOMAIN_ID"] = str(domain)
    found.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # a loop's matrices are too small for more
        found.setdefault(name, "1")
    if "HOME" not in found:
        found.setdefault("ROS_LOG_DIR", str(Path(tempfile.gettempdir()) / "ros_log"))
    return found
