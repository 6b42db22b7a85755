"""A picture as the goal of the exact MPC."""
