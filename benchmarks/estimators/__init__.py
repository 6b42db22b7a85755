"""This project's estimators beside others on the simulated beam, in one run."""
