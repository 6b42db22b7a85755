"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.estimators"

EXTENSION = Extension(
    name="estimators",
    summary="An unscented Kalman filter, and moving-horizon estimation.",
    provides={
        "estimators": {
            "ukf": f"{HERE}.unscented_kalman_filter:UnscentedKalmanFilter",
            "mhe": f"{HERE}.moving_horizon_estimator:MovingHorizonEstimator",
        }
    },
)
