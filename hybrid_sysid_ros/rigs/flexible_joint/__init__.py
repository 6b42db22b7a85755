"""The flexible-joint manipulator."""
