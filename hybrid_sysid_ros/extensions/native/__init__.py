"""The loop of a rig as one native process: estimator and controller in C, on rcl."""
