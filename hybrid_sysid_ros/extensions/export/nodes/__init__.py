"""What the loop on a board does in ROS 2."""
