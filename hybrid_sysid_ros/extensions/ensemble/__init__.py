"""Ensemble: several models of one rig together."""
