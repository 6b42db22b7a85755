"""Checks: of an installation, and of a rig before its first record."""
