"""Friction: levels over speed (here), laws as systems with their parameters, and experiments on them."""

from hybrid_sysid_ros.core.friction.levels import rational_stribeck, stefanski, stribeck

__all__ = ["rational_stribeck", "stefanski", "stribeck"]
