"""Figures of forecast loops."""
