"""What every room stands on: errors, files, interruption, progress, threads, optional libraries."""
