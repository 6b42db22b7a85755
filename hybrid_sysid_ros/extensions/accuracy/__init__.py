"""Accuracy: statements from simulated and live shots, and the mock-up."""
