"""The cam-driven beam."""
