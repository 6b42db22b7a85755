"""hybrid-sysid set: parameters of a running node."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Json
from hybrid_sysid_ros.commands.terminal import console
from hybrid_sysid_ros.extensions.graph.asking import SLOW, Domain, LoopRig, NodeName, Timeout, ask
from hybrid_sysid_ros.support.errors import UserError


def command(
    node: NodeName,
    values: Annotated[
        list[str], typer.Argument(metavar="NAME=VALUE", help="New values, all or none of which are taken.")
    ],
    rig: LoopRig = "",
    timeout: Timeout = SLOW,
    domain: Domain = None,
    as_json: Json = False,
) -> None:
    """Set parameters of a running node; a value that it refuses changes nothing."""
    given = {}
    for text in values:
        name, equals, value = text.partition("=")
        if not name or not equals:
            raise UserError(f"{text!r}: write NAME=VALUE, such as 'rate_weight=[20.0]'")
        given[name] = value
    answer = ask("set", node=node, values=given, namespace=rig, timeout=timeout, domain=domain)
    if as_json:
        console.print(json.dumps(answer["values"], indent=2))
        return
    for name, value in answer["values"].items():
        console.print(f"{answer['node']}: {name} = {json.dumps(value)}")
