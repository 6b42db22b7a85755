"""Calibration: gain, offset, delay and window of sensors are fitted beside the physics."""
