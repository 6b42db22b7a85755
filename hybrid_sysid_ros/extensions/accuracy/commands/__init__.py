"""Commands about accuracy."""
