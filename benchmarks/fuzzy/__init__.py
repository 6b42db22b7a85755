"""Fuzzy models measured: identification, control, time series, functions."""
