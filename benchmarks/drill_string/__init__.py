"""The drill string: identification under a brake that nobody knows, and controllers that end stick-slip."""
