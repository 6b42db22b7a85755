"""Commands that train and certify policies."""
