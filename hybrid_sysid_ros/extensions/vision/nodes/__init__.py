"""Nodes of cameras."""
