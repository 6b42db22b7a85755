"""Validation of a model on unseen records: scores, horizons, residual tests, re-simulated loops."""
