"""Frequency responses of models, with bands, beside those of records."""
