"""Commands of the view."""
