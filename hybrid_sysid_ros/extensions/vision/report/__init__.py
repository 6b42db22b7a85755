"""Report sections about films."""
