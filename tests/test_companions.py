"""Companions of a rig's nodes: those of several extensions together."""

from __future__ import annotations

import pytest

from hybrid_sysid_ros.runtime.companion import Companion, NodeValues, RequestedLoop, join
from hybrid_sysid_ros.support.errors import UserError


class Pushing(Companion):
    """Wants one value of the plant's bias."""

    def __init__(self, name: str, bias: float) -> None:
        self.name, self.bias = name, bias  # type: ignore[misc]

    def parameters(self, loop: RequestedLoop) -> NodeValues:
        return {"plant": {"bias": self.bias}, "recorder": {"further": "push"}, self.name: {}}


def test_companions_that_agree_join_and_others_are_refused() -> None:
    values: NodeValues = {"plant": {"rate": 200.0, "bias": 0.0}}
    join(RequestedLoop(rig=""), values, [Pushing("a", 1.0), Pushing("b", 1.0)])
    assert values == {"plant": {"rate": 200.0, "bias": 1.0}, "a": {}, "b": {}}
    with pytest.raises(UserError, match="a and b want different values of bias of the plant"):
        join(RequestedLoop(rig=""), {}, [Pushing("a", 1.0), Pushing("b", 2.0)])


def test_a_companion_tells_a_recorder_only_where_there_is_one() -> None:
    values: NodeValues = {"recorder": {}}
    join(RequestedLoop(rig="", recorded=True), values, [Pushing("a", 1.0)])
    assert values["recorder"] == {"further": "push"}
    assert Pushing("a", 1.0).nodes(RequestedLoop(rig="")) == {"a"}
