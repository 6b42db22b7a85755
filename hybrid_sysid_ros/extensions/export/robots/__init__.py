"""Joints of a model in files of other programs: URDF and MJCF."""
