"""Figures of bands over the horizon."""
