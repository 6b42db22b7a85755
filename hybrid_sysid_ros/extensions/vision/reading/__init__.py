"""Angles out of films."""
