"""Policies: networks trained to imitate the exact MPC, and their certificates."""
