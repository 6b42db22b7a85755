"""The next experiment: an excitation that tells most of what a model does not know yet."""
