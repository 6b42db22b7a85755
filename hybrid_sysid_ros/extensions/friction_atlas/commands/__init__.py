"""The command that draws laws of friction."""
