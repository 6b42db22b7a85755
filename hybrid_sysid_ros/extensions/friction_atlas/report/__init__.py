"""What this extension adds to reports."""
