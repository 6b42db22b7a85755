"""Readers under mutated files: see __main__."""
