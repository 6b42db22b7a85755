"""The command that designs experiments."""
