"""The flexible joint: its models on unseen records, and steps of its link under PI, exact MPC and policy."""
