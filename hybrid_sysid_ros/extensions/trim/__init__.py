"""Trim: where a rig stays as it is, and the modes in which it moves about there."""
