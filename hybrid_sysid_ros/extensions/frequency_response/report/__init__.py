"""The page of frequency responses."""
