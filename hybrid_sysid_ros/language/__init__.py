"""Commands in plain language: sentences become commands, commands plans, and plans are simulated before they move."""
