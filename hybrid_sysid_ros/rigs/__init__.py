"""Rigs, one folder each, and their common parts: sensors, actuators, the simulated plant, experiments."""
