"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.drift_alarm"
EXTENSION = Extension(
    name="drift_alarm",
    summary="An alarm where a loop's innovations drift.",
    provides={"loop_checks": {"drift_alarm": f"{HERE}.drift_alarm:alarm_of"}},
)
