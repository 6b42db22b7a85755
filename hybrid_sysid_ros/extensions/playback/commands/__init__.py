"""Commands about recorded loops."""
