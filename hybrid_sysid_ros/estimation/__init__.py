"""Kalman filters and moving-horizon estimation for any model, behind one interface."""

from hybrid_sysid_ros.estimation.estimator import Counters, Estimator, StateEstimate
from hybrid_sysid_ros.estimation.extended_kalman_filter import ExtendedKalmanFilter
from hybrid_sysid_ros.estimation.moving_horizon_estimator import MovingHorizonEstimator
from hybrid_sysid_ros.estimation.tuning import SensorChannel, Tuning
from hybrid_sysid_ros.estimation.unscented_kalman_filter import UnscentedKalmanFilter

METHODS: dict[str, type[Estimator]] = {
    "ekf": ExtendedKalmanFilter,
    "ukf": UnscentedKalmanFilter,
    "mhe": MovingHorizonEstimator,
}
"""The estimators by name."""

__all__ = [
    "METHODS",
    "Counters",
    "Estimator",
    "ExtendedKalmanFilter",
    "MovingHorizonEstimator",
    "SensorChannel",
    "StateEstimate",
    "Tuning",
    "UnscentedKalmanFilter",
]
