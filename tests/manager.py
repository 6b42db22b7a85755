"""What a manager asks a node for, by its services."""

from __future__ import annotations

from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from tests.node_bench import Bench, ask

CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP


def change(bench: Bench, node: str, transition: int) -> bool:
    return bool(ask(bench, ChangeState, f"{node}/change_state", _request(transition)).success)


def _request(transition: int) -> ChangeState.Request:
    request = ChangeState.Request()
    request.transition.id = transition
    return request


def state(bench: Bench, node: str) -> str:
    return str(ask(bench, GetState, f"{node}/get_state", GetState.Request()).current_state.label)


def set_parameter(bench: Bench, node: str, name: str, value: Any) -> str:
    """The reason why a parameter can't be set; empty where it was."""
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    result = ask(bench, SetParameters, f"{node}/set_parameters", request).results[0]
    assert result.successful == (not result.reason)
    return str(result.reason)
