"""The page of checked records."""
