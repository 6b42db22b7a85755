"""A colcon package with a ros2_control controller around a loop."""
