"""Operating point: an MPC about the steady motion at given outputs."""
