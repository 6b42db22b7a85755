"""What a report shows of state-space models."""
