"""Controller report: what a controller says that it does, and whether anything moves then."""

from __future__ import annotations

from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus

FOLLOWS = ("", "driving", "slowed")
"""States in which references are followed, or of which nobody has said anything yet."""


class ControllerReport(NamedTuple):
    """The newest one of a controller."""

    state: str = ""
    """"driving", "slowed", "holding", "resting", "stopped", "disarmed", "inactive" ...; "" before the first."""
    reason: str = ""
    published: int = 0
    """In system time [ns]."""
    stops: int = 0
    """That the controller was asked for."""

    @classmethod
    def of(cls, status: DiagnosticStatus, published: int) -> ControllerReport:
        """That of a status of its task "loop"; a controller that is not active names its state alone."""
        values = {item.key: item.value for item in status.values}
        stops = int(values.get("stops", "0"))
        return cls(values.get("state", status.message), values.get("state_reason", ""), published, stops)

    @property
    def standstill(self) -> str:
        """That nothing moves, why, and what to do; "" where references are followed."""
        if self.state in FOLLOWS:
            return ""
        if self.reason.startswith(self.state):  # asked for by a service, which it names
            return f"nothing moves: the controller is {self.reason}"
        if self.state in ("holding", "resting"):
            said = f"nothing moves: the controller is {self.state} ({self.reason})"
            return f"{said}: wait until it drives again, or look at its diagnostics"
        return f"nothing moves: the controller is {self.state}: {self.reason or 'activate it'}"

    @property
    def slowed(self) -> str:
        """That the outputs may lag behind; "" where they do not."""
        return f", but the controller is slowed ({self.reason}): outputs lag behind" if self.state == "slowed" else ""
