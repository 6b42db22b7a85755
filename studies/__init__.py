"""What one paper or lecture did, on the library."""
