"""The command that promotes a model."""
