"""Pages: the documentation, read where it was installed."""
