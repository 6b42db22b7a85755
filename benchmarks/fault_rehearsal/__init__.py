"""Fault rehearsal: loops without a clock under faults of sensors and actuators, which repeat bit by bit."""
