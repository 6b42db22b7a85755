"""Soak: the loop for half an hour, alone and beside busy processes."""
