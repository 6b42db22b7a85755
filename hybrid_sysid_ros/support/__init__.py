"""Common foundations: errors, files, interruption, progress, threads, optional libraries."""
