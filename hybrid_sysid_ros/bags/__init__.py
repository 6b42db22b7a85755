"""Bags in and out: rosbag2 folders and MCAP files, without ROS installed."""

from hybrid_sysid_ros.bags.bag import METADATA, Topic, name_of
from hybrid_sysid_ros.bags.contents import topics
from hybrid_sysid_ros.bags.reading import read
from hybrid_sysid_ros.bags.series import Series, joint_states, joint_trajectories, series
from hybrid_sysid_ros.bags.writing import BagWriter, write

__all__ = [
    "METADATA",
    "BagWriter",
    "Series",
    "Topic",
    "joint_states",
    "joint_trajectories",
    "name_of",
    "read",
    "series",
    "topics",
    "write",
]
