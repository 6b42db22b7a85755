"""Search: options of structures chosen by cross-validation."""
