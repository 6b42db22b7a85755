"""What nodes of several extensions share."""
