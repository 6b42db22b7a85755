"""Faults: what a loop of real processes does under them."""
