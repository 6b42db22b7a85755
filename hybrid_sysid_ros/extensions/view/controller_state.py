"""Controller state: what a controller does just now, in a word, and why."""

from __future__ import annotations

from collections.abc import Mapping

STATES = ("driving", "slowed", "holding", "resting", "stopped", "disarmed")
"""What a controller can say; anything else is shown as it is said."""
OF_MESSAGE = {"stopped": "stopped", "holding": "holding", "waiting": "resting", "inactive": "resting"}
"""The state by the first word of the status, of a controller that names no state."""
OF_LAYER = {
    "layer_stopped": ("stopped", "the service stop was called"),
    "layer_zeroed": ("resting", "nothing sound has come for too long"),
    "layer_held": ("holding", "the estimate is late or no number"),
    "layer_no_reference": ("holding", "there is no reference yet"),
}
"""State and reason by the layer of safety that answered, of a controller that names no state; the gravest first."""


class ControllerState:
    """State of one controller, by its diagnostics in their order."""

    def __init__(self) -> None:
        self._before: Mapping[str, int] = {}

    def read(self, message: str, values: Mapping[str, str]) -> tuple[str, str]:
        """State and reason by the message and the values of the status of its task loop."""
        counts = {name: int(values[name]) for name in OF_LAYER if values.get(name, "").isdigit()}
        grown = {name: count - self._before.get(name, 0) if self._before else 0 for name, count in counts.items()}
        self._before = counts
        layer, why = next((found for name, found in OF_LAYER.items() if grown.get(name, 0) > 0), ("driving", ""))
        if state := values.get("state"):
            return state, values.get("state_reason") or (why if state == layer else "")
        word = message.partition(" ")[0]
        if word in OF_MESSAGE:
            return OF_MESSAGE[word], message
        return layer, why or ("" if message == "running" else message)
