"""What a camera before a rig tells: angles, time, friction, and the loop closed by it."""
