"""A camera in front of a simulated rig, and films: files of pictures."""
