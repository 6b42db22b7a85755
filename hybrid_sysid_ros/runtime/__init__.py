"""Running a rig: the configuration of its nodes, their processes, and recorded loops."""
