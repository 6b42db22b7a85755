"""Problems that the documentation of other solvers shows, each declared in some lines."""
