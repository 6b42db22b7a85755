"""Importing: records of other worlds become bags of a rig."""
