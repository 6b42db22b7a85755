"""Parameters: what msgs_config describes, declared in ROS with its range, checked at the start and at every change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from hybrid_sysid_ros.rigs.rig import default
from hybrid_sysid_ros.runtime.parameters import Parameter, parameters
from hybrid_sysid_ros.support.errors import UserError

RIG = Parameter(name="rig", default="", description="the rig, by its name or by the path of its folder")
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def declare(node: Node, section: str) -> dict[str, Any]:
    """Declare the parameters of a node and return their values by name, "rig" among them.

    The node was created with automatically_declare_parameters_from_overrides; what it was given replaces the defaults.
    The dictionary follows later changes of the parameters that may change. Raises UserError where a parameter is
    unknown, of the wrong type or out of range.
    """
    given = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
        if not name.startswith(OF_ROS)
    }
    for name in given:
        node.undeclare_parameter(name)
    rig = given["rig"] = RIG.checked(given.get("rig", RIG.default)) or default()
    known = {"rig": RIG, **parameters(rig, section)}
    for name in given:
        if name not in known:
            raise UserError(f"unknown parameter {name}: known are {', '.join(known)}")
    values = {name: item.checked(given.get(name, item.default)) for name, item in known.items()}
    for name, item in known.items():
        node.declare_parameter(name, values[name], _descriptor(item), ignore_override=True)
    node.add_on_set_parameters_callback(lambda changes: _change(known, values, changes))
    return values


def _change(known: Mapping[str, Parameter], values: dict[str, Any], changes: list[RosParameter]) -> SetParametersResult:
    """Check all, then apply all. The others are read-only, which rclpy sees to."""
    try:
        checked = {change.name: known[change.name].checked(change.value) for change in changes if change.name in known}
    except UserError as error:
        return SetParametersResult(successful=False, reason=str(error))
    values.update(checked)
    return SetParametersResult(successful=True)


def _descriptor(item: Parameter) -> ParameterDescriptor:
    unit = f" [{item.unit}]" if item.unit else ""
    limits = f"each within [{item.low:g}, {item.high:g}]" if item.each else ""
    choices = f"one of {', '.join(item.choices)}" if item.choices else ""
    descriptor = ParameterDescriptor(
        description=f"{item.description}{unit}", additional_constraints=limits or choices, read_only=not item.live
    )
    if item.each or not math.isfinite(item.low):
        return descriptor  # ROS has no range for lists
    if item.kind is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(item.low), to_value=float(item.high))]
    else:
        descriptor.integer_range = [IntegerRange(from_value=int(item.low), to_value=int(item.high), step=1)]
    return descriptor
