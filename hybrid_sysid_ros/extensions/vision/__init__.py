"""Vision: simulated cameras, films read as records, and the loop closed by a camera."""
