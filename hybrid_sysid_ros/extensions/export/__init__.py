"""Export: models and policies outside of Python."""
