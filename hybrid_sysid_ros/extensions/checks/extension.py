"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.checks"
EXTENSION = Extension(
    name="checks",
    summary="An installation and a rig, checked before they are used.",
    commands={
        "check": (f"{HERE}.commands.check", "Check the installation in a quarter of a minute."),
        "rig check": (f"{HERE}.commands.rig_check", "Check a rig and show its step response."),
    },
)
