"""The command that scores models together."""
