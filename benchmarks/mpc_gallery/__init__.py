"""Problems like those that the documentation of other solvers shows, each declared in some lines.

The data are written from memory or from textbooks.
"""
