"""The ROS 2 nodes, which are thin: a message comes in, an algorithm runs, a message goes out. Only nodes import ROS."""
