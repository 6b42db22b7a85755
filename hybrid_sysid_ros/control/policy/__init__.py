"""The approximate MPC: a network, its training on closed loops of the exact one, and its folder."""
