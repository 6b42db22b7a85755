"""State-space models of any order from inputs and outputs alone."""
