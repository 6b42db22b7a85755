"""The ROS 2 nodes: thin, message in, algorithm, message out. Nothing else in the package imports ROS."""
