"""Bands of closed loops that are forecast from their commands."""
