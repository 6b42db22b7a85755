"""Nodes that publish what was recorded."""
