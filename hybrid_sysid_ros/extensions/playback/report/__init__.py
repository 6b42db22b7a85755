"""The report of a loop answered again."""
