"""Composed node: nodes of one rig, or of several, in one process and one loop."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from functools import partial
from importlib import import_module
from typing import Any

from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args

from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.exchange import Exchange
from hybrid_sysid_ros.nodes.middleware import leaves_alone
from hybrid_sysid_ros.nodes.process import run

KINDS: Mapping[str, str] = {
    "plant": "PlantNode",
    "estimator": "EstimatorNode",
    "controller": "ControllerNode",
    "reference": "ReferenceNode",
}
"""Nodes of the loop by name; a recorder runs in a process of its own, with a lower priority."""


def compose(arguments: list[str]) -> list[RigNode]:
    """Make the nodes that a command line names. Raises UserError for a wrong parameter."""
    parser = argparse.ArgumentParser(prog="composed", description=__doc__)
    parser.add_argument("--nodes", nargs="+", choices=list(KINDS), default=list(KINDS), help="all by default")
    parser.add_argument("--namespaces", nargs="+", default=[""], help="of the rigs; by default the one of __ns")
    parser.add_argument("--rigs", nargs="+", default=[], help="names or paths, one for each namespace")
    asked = parser.parse_args(arguments)
    rigs = asked.rigs or [""] * len(asked.namespaces)
    if len(rigs) != len(asked.namespaces):
        parser.error(f"{len(asked.namespaces)} namespaces and {len(rigs)} rigs: give one for each")
    made: list[RigNode] = []
    exchange = Exchange() if leaves_alone() else None
    for namespace, rig in zip(asked.namespaces, rigs, strict=True):
        options: dict[str, Any] = {"exchange": exchange, **({"namespace": namespace} if namespace else {})}
        options |= {"parameter_overrides": [Parameter("rig", value=rig)]} if rig else {}
        made.extend(_kind(name)(**options) for name in asked.nodes)
    return made


def _kind(name: str) -> type[RigNode]:
    found: type[RigNode] = getattr(import_module(f"hybrid_sysid_ros.nodes.{name}"), KINDS[name])
    return found


def main() -> int:
    """Run the nodes until one of them is finished."""
    return run(partial(compose, remove_ros_args(sys.argv)[1:]), together=True)


if __name__ == "__main__":
    sys.exit(main())
