"""Estimators: an unscented Kalman filter and moving-horizon estimation, beside the extended filter of the trunk."""
