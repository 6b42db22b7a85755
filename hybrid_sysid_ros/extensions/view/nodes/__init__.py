"""The node that serves the live view."""
