"""From a sentence to a checked plan."""
