"""Report pages about accuracy."""
