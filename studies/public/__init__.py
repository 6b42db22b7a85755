"""Public benchmarks with their official splits and starts."""
