"""The command that compares frequency responses."""
