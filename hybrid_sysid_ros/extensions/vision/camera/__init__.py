"""Simulated cameras and the films that they take."""
