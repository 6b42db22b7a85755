"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.calibration"
EXTENSION = Extension(
    name="calibration",
    summary="Gain, offset, delay and window of sensors, fitted beside the physics.",
    provides={"wrappers": {"calibration": f"{HERE}.calibrated:Calibration"}},
)
