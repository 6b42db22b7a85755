"""Prediction error: parameters by the innovations of a filter whose input offset walks."""
