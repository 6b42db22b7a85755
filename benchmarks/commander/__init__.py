"""Commands in plain language: how fast they are read, simulated and stopped, and that no text breaks a limit."""
