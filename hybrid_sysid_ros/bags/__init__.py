"""Reading and writing bags: rosbag2 folders and MCAP files, without ROS installed."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hybrid_sysid_ros.bags.attachments import attached, collected, laid_out
    from hybrid_sysid_ros.bags.bag import METADATA, Topic, markers, name_of, topics
    from hybrid_sysid_ros.bags.quality_of_service import QualityOfService
    from hybrid_sysid_ros.bags.reading import read
    from hybrid_sysid_ros.bags.series import Series, joint_states, joint_trajectories, repeated
    from hybrid_sysid_ros.bags.writing import BagWriter, Recording, Split, write_bag

__all__ = [
    "METADATA",
    "BagWriter",
    "QualityOfService",
    "Recording",
    "Series",
    "Split",
    "Topic",
    "attached",
    "collected",
    "joint_states",
    "joint_trajectories",
    "laid_out",
    "markers",
    "name_of",
    "read",
    "repeated",
    "topics",
    "write_bag",
]

_FILES = {
    **dict.fromkeys(("METADATA", "Topic", "markers", "name_of", "topics"), "bag"),
    **dict.fromkeys(("Series", "joint_states", "joint_trajectories", "repeated"), "series"),
    **dict.fromkeys(("BagWriter", "Split", "write_bag"), "writing"),
    "QualityOfService": "quality_of_service",
    **dict.fromkeys(("attached", "collected", "laid_out"), "attachments"),
    "read": "reading",
    "Recording": "writing",
}


def __getattr__(name: str) -> Any:
    """Import readers and writers of bags when they are used: a node needs signals, but no bag library."""
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_FILES[name]}"), name)
