"""Drift alarm: a running loop tells that its model no longer fits the rig, at a stated rate of false alarms."""
