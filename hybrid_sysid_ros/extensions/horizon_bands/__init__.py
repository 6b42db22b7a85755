"""Bands of predictions some samples ahead."""
