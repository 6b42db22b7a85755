"""Parameters of msgs_config: declared in ROS with their ranges, checked at the start and at every change."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from hybrid_sysid_ros.nodes.topics import check_override
from hybrid_sysid_ros.rigs.rig import default
from hybrid_sysid_ros.runtime.parameters import NodeParameter, check_rules, declarations, parameters, unknown

RIG = NodeParameter(name="rig", default="", description="Rig, by its name or by the path of its folder")
OF_ROS = ("use_sim_time", "start_type_description_service")
OF_QUALITY = "qos_overrides."
TakeParameters = Callable[[Mapping[str, Any], Sequence[str]], None]
"""Receives checked values by name, and the names of changed values that are not live parameters."""


def declare(
    node: Node,
    section: str,
    take: TakeParameters,
    carried: Mapping[str, Collection[str]],
    describe: Callable[[Exception], str],
) -> dict[str, Any]:
    """Declare the parameters of a node and return their values by name, "rig" among them.

    The node was created with automatically_declare_parameters_from_overrides: given values replace the defaults, and
    parameters of other nodes are ignored, so that one file may serve all nodes. take: see TakeParameters. carried: full
    names of the node's topics by entity. describe: gives an error in a line.

    Raises UserError where a parameter is unknown, of the wrong type, out of range, or violates a rule with another one.
    """
    given = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
        if not name.startswith(OF_ROS)
    }
    for name in [name for name in given if name.startswith(OF_QUALITY)]:
        check_override(name, given.pop(name), carried)
    for name in given:
        node.undeclare_parameter(name)
    rig = given["rig"] = RIG.checked(given.get("rig", RIG.default)) or default()
    known = {"rig": RIG, **parameters(rig, section)}
    others = {name for names in declarations().values() for name in names} - known.keys()
    for name in given.keys() - others:
        if name not in known:
            raise unknown(name, known)
    values = {name: item.checked(given.get(name, item.default)) for name, item in known.items()}
    check_rules(known, values)
    for name, item in known.items():
        node.declare_parameter(name, values[name], _descriptor(item), ignore_override=True)
    node.add_on_set_parameters_callback(partial(_change, known, values, take, describe))
    return values


def _change(
    known: Mapping[str, NodeParameter],
    values: Mapping[str, Any],
    take: TakeParameters,
    describe: Callable[[Exception], str],
    changes: list[RosParameter],
) -> SetParametersResult:
    """Check all changes, then accept all."""
    try:
        given = {change.name: known[change.name].checked(change.value) for change in changes if change.name in known}
        check_rules(known, {**values, **given})
        if given:
            take(given, [name for name, value in given.items() if not known[name].live and value != values[name]])
    except Exception as error:  # after any error the node keeps its values
        return SetParametersResult(successful=False, reason=describe(error))
    return SetParametersResult(successful=True)


def _descriptor(item: NodeParameter) -> ParameterDescriptor:
    unit = f" [{item.unit}]" if item.unit else ""
    said = [f"each within {item.within}"] if item.each else []
    said += [f"one of {', '.join(item.choices)}"] if item.choices else []
    said += [f"more than {item.above}"] if item.above else []
    said += [] if item.live else ["read when the node is configured"]
    descriptor = ParameterDescriptor(
        description=f"{item.description}{unit}", additional_constraints="; ".join(said), read_only=item is RIG
    )
    descriptor.dynamic_typing = bool(item.each)  # one number may stand for all
    if item.each or not math.isfinite(item.low):
        return descriptor  # ROS has no range for lists
    if item.kind is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(item.low), to_value=float(item.high))]
    else:
        descriptor.integer_range = [IntegerRange(from_value=int(item.low), to_value=int(item.high), step=1)]
    return descriptor
