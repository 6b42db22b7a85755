"""From a bag to a controlled rig: hybrid models, estimators, exact and learned MPC."""
