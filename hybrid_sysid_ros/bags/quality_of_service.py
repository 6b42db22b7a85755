"""Quality of service of a publisher, in rosbag2's terms. Nodes import it without any library of bags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

ENDLESS = {"sec": 9223372036, "nsec": 854775807}
"""An infinite duration."""
NUMBERED = {
    "reliability": {1: "reliable", 2: "best_effort"},
    "durability": {1: "transient_local", 2: "volatile"},
    "history": {1: "keep_last", 2: "keep_all"},
}
"""Meaning of the numbers before version 9 of metadata.yaml."""


@dataclass(frozen=True, kw_only=True)
class QualityOfService:
    """Quality of service, as far as it is needed to publish again; policies as in rosbag2's metadata.yaml."""

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10

    @property
    def description(self) -> dict[str, Any]:
        """The profile in the form of metadata.yaml."""
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
    def of(cls, profile: Mapping[str, Any]) -> QualityOfService:
        """A profile from metadata.yaml of any version. Raises KeyError, TypeError or ValueError for anything else."""
        policies = {name: known.get(profile[name], str(profile[name])) for name, known in NUMBERED.items()}
        return cls(**policies, depth=int(profile["depth"]))
