"""hybrid-sysid call: a service of running nodes."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from hybrid_sysid_ros.commands.options import Json
from hybrid_sysid_ros.commands.terminal import console, end
from hybrid_sysid_ros.extensions.graph.asking import Domain, LoopRig, Timeout, ask


def command(
    service: Annotated[
        str,
        typer.Argument(
            metavar="SERVICE",
            help="Name of the service, such as stop, or plant/reset for that of one node; without it they are listed.",
        ),
    ] = "",
    rig: LoopRig = "",
    timeout: Timeout = 5.0,
    domain: Domain = None,
    as_json: Json = False,
) -> None:
    """Call a service of the running nodes (std_srvs/Trigger): stop, hold, enable, reset, arm, disarm, estop (rest at
    once) and what else they offer.

    Every node of the rig that offers it is called.
    """
    if not service:
        offered = ask("services", namespace=rig, domain=domain)
        console.print(json.dumps(offered, indent=2) if as_json else "\n".join(offered))
        return
    answers = ask("call", service=service, namespace=rig, timeout=timeout, domain=domain)
    if as_json:
        console.print(json.dumps(answers, indent=2))
    for answer in answers:
        if answer["done"] and not as_json:
            console.print(f"{answer['service']}: {answer['message'] or 'done'}")
    end([f"{answer['service']}: {answer['message']}" for answer in answers if not answer["done"]])
