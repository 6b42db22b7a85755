"""Commands that import records and make rigs of them."""
