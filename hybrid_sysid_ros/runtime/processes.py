"""Processes: the environment and priority of a process that needs ROS, for which this one needs none."""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from pathlib import Path

from hybrid_sysid_ros.support.errors import UserError

REAL_TIME_PRIORITY = 10  # of the loop's processes: above every ordinary one, below what a system keeps for itself
LISTENING_PRIORITY = 1
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
"""Variables that are 1 unless the user says otherwise: a loop's matrices are too small for more threads."""
IN_LOOP = ("plant", "estimator", "controller")


def module(name: str, *arguments: str) -> list[str]:
    """The command that runs a module that needs ROS, by its full name."""
    return [sys.executable, "-m", name, *arguments]


def has_ros() -> bool:
    """Whether ROS is available for this Python."""
    return importlib.util.find_spec("rclpy") is not None


def check_ros() -> None:
    """Raise UserError without ROS for this Python; called before long work that ends in nodes."""
    if not has_ros():
        raise UserError("no rclpy for this Python: install hybrid_sysid_ros[ros], or source a ROS 2 Jazzy")


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
