"""The rigs: a file a rig, and what they share."""
