"""Kalman filters on any model."""

from hybrid_sysid_ros.estimation.estimate import Counters, Estimate, Estimator
from hybrid_sysid_ros.estimation.extended_kalman_filter import ExtendedKalmanFilter, Tuning

__all__ = ["Counters", "Estimate", "Estimator", "ExtendedKalmanFilter", "Tuning"]
