"""The rigs: a folder each, and what they share: sensors, actuators, the simulated plant, experiments."""
