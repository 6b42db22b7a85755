"""Parameters that are asked of other nodes: an answer that is lost holds nobody up for good."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install hybrid_sysid_ros[ros]")

from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from hybrid_sysid_ros.extensions.shared.nodes.collector import Uncalled
from hybrid_sysid_ros.nodes import parameter_query
from hybrid_sysid_ros.nodes.parameter_query import ParameterQuery
from hybrid_sysid_ros.nodes.reference import ReferenceNode
from tests.node_bench import Bench


def test_who_does_not_answer_is_asked_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_query, "PERIOD", 0.02)
    asked = Node("controller", context=bench.context, namespace=bench.namespace, start_parameter_services=False)
    service = bench.add(asked).create_service(
        GetParameters, "controller/get_parameters", lambda request, answer: answer, callback_group=Uncalled()
    )  # which is answered by hand
    heard: dict[str, dict[str, Any]] = {}
    ParameterQuery(bench.start(ReferenceNode, autostart=False), ["controller"], heard.__setitem__)

    def taken() -> Any:
        request, information = service.handle.service_take_request(GetParameters.Request)
        return None if request is None else (request, information)

    bench.until(taken)  # lost
    request, information = bench.until(taken)
    values = [ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=name) for name in request.names]
    service.handle.service_send_response(GetParameters.Response(values=values), information.request_id)
    bench.until(lambda: heard)
    assert heard["controller"]["policy"] == "policy"
