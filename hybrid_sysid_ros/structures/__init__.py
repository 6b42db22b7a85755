"""The model structures of the trunk, one class each: options, fit, stored form and description."""
