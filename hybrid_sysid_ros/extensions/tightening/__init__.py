"""Tightening: plans that keep their bounds although model and estimate are not exact."""
