"""A model or a simulated rig as C."""
