"""The command that trims."""
