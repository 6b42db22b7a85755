"""The exact MPC: multiple shooting, its quadratic programs, and IPOPT beside it."""
