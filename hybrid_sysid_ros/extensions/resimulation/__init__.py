"""Resimulation: the closed loop of a record done again on a model."""
