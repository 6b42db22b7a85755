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
from hybrid_sysid_ros.support.errors import UserError

COMPOSED = "composed"
"""Module of several nodes in one process."""
REAL_TIME_PRIORITY = 10  # of the loop's processes: above every ordinary one, below what a system keeps for itself


def command(node: str, values: Mapping[str, Any], *, rig: str = "", namespace: str = "") -> list[str]:
    """Command that starts a node with these parameters; the others have their defaults. rig: by default the one that is
    meant where none is named. Raises UserError where a parameter is unknown or not allowed.
    """
    return [*_beginning(node, rig=rig, namespace=namespace), *_arguments(rig, node, values)]


def composed(values: Mapping[str, Mapping[str, Any]], *, rig: str, namespace: str) -> list[str]:
    """Command that starts nodes with their parameters in one process. Raises UserError: see command()."""
    given = [argument for node in values for argument in _arguments(rig, node, values[node], f"{node}:")]
    return [*_beginning(COMPOSED, "--nodes", *values, rig=rig, namespace=namespace), *given]


def _beginning(module: str, *arguments: str, rig: str, namespace: str) -> list[str]:
    words = [sys.executable, "-m", f"hybrid_sysid_ros.nodes.{module}", *arguments, "--ros-args"]
    return [*words, "-r", f"__ns:=/{namespace}", "-p", f"rig:={json.dumps(rig)}"]


def _arguments(rig: str, node: str, values: Mapping[str, Any], prefix: str = "") -> list[str]:
    known, found = configuration.parameters(rig or rigs.default(), node), []
    checked = {name: item.default for name, item in known.items()}
    try:
        for name, value in values.items():
            if name not in known:
                raise UserError(f"unknown parameter {name}: known are {', '.join(known)}")
            checked[name] = known[name].checked(value)
            found += ["-p", f"{prefix}{name}:={json.dumps(checked[name])}"]
        configuration.check_rules(known, checked)
    except UserError as error:
        raise UserError(f"{node}: {error}") from error
    return found


def permitted_priority() -> int:
    """REAL_TIME_PRIORITY where this process may have one (as root, or by `ulimit -r`), else 0."""
    try:
        before = os.sched_getscheduler(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except (OSError, AttributeError):  # not permitted, or no Linux
        return 0
    return REAL_TIME_PRIORITY


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
