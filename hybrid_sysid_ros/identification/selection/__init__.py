"""Which structure and options to take, by training data alone."""
