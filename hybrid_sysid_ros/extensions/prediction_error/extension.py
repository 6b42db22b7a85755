"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.prediction_error"
EXTENSION = Extension(
    name="prediction_error",
    summary="Parameters by the prediction errors of a filter whose input offset walks.",
    provides={"criteria": {"prediction": f"{HERE}.fitting:fitted"}},
)
