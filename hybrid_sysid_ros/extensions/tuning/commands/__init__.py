"""The command that tunes."""
