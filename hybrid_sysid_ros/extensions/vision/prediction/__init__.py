"""Motion and pictures predicted ahead."""
