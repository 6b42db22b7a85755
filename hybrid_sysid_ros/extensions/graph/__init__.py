"""Graph: the running nodes asked from the command line, without ROS's own commands."""
