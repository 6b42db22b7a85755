"""Promotion: a model takes the place of another one where held-out records say that it is better."""
