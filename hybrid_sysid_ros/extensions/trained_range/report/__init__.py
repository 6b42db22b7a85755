"""What a report shows of the range that a model was trained on."""
