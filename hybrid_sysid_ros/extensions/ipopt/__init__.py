"""IPOPT: the problem of the exact MPC solved by an interior-point method, slowly, as a reference."""
