"""The exact MPC: multiple shooting, and its quadratic programs."""
