"""What runs a rig: the configuration of its nodes, their processes, and the loop that a bag recorded."""
