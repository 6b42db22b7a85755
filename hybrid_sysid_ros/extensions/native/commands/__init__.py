"""Commands of the native loop."""
