"""Quality: how a publisher offers a topic, in the words of rosbag2. Nodes read it, and no library of bags with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

ENDLESS = {"sec": 9223372036, "nsec": 854775807}
"""A duration without end."""
NUMBERED = {
    "reliability": {1: "reliable", 2: "best_effort"},
    "durability": {1: "transient_local", 2: "volatile"},
    "history": {1: "keep_last", 2: "keep_all"},
}
"""What the numbers stood for before version 9 of metadata.yaml."""


@dataclass(frozen=True, kw_only=True)
class Quality:
    """A quality of service: what matters of it to who publishes again; policies as in rosbag2's metadata.yaml."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10

    @property
    def description(self) -> dict[str, Any]:
        """The profile as metadata.yaml has it."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(ENDLESS),
            "lifespan": dict(ENDLESS),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(ENDLESS),
            "avoid_ros_namespace_conventions": False,
        }

    @classmethod
    def of(cls, profile: Mapping[str, Any]) -> Quality:
        """A profile out of metadata.yaml, of any version. Raises KeyError, TypeError or ValueError where it is none."""
        policies = {name: known.get(profile[name], str(profile[name])) for name, known in NUMBERED.items()}
        return cls(**policies, depth=int(profile["depth"]))
