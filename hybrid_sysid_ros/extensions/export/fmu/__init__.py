"""Functional mock-up units, FMI 3.0."""
