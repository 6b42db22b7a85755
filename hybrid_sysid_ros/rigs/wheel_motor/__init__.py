"""The motor of a wheeled robot, from PWM counts to the speed of its wheel."""
