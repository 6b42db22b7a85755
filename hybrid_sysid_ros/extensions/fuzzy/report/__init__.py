"""What a report shows of fuzzy models."""
