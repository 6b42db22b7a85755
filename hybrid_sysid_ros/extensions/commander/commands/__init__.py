"""Commands that speak to the commander."""
