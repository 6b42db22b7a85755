"""Command replies: what the commander answers, on command_reply, where the bag finds it."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from hybrid_sysid_ros.nodes.base import RigNode


class CommandReplies:
    """The replies of an active node."""

    def __init__(self, node: RigNode) -> None:
        self._publisher = node.open("command_reply")
        self._name = f"{node.get_fully_qualified_name().strip('/')}: command"
        self._rig = node.rig.name

    def send(self, text: str, state: str, line: str, level: bytes, values: Mapping[str, float]) -> None:
        """To a text, which state its command has come to, in a line and in numbers."""
        entries = {"text": text[:300], "state": state, **{name: f"{value:.6g}" for name, value in values.items()}}
        pairs = [KeyValue(key=key, value=value) for key, value in entries.items()]
        status = DiagnosticStatus(level=level, name=self._name, message=line, hardware_id=self._rig, values=pairs)
        self._publisher.publish(status)
