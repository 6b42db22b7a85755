"""The approximate MPC: a network that imitates the exact one, its training settings and its folder."""
