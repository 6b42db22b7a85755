"""The winged-cone vehicle: its equilibria, its autopilot on random plants, and identification under the loop."""
