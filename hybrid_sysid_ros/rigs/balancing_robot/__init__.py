"""A balancing robot on two wheels, from PWM counts to speed, yaw and tilt."""
