"""Driver: the beginning of a node that drives a rig's hardware."""
