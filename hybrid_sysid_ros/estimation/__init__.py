"""State estimation for any model, behind one interface."""

from hybrid_sysid_ros.estimation.estimator import Counters, Estimator, StateEstimate
from hybrid_sysid_ros.estimation.extended_kalman_filter import ExtendedKalmanFilter
from hybrid_sysid_ros.estimation.tuning import SensorChannel, Tuning
from hybrid_sysid_ros.support import extensions


def estimator_class(method: str) -> type[Estimator]:
    """The estimator of a method: "ekf", or one of an extension. Raises UserError where none provides it."""
    found: type[Estimator] = extensions.one("estimators", method, f"method {method}")
    return found


__all__ = [
    "Counters",
    "Estimator",
    "ExtendedKalmanFilter",
    "SensorChannel",
    "StateEstimate",
    "Tuning",
    "estimator_class",
]
