"""Selection of structure and options by training data alone."""
