"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="driver",
    summary="The beginning of a driver of a rig's hardware.",
    commands={
        "rig driver": (
            "hybrid_sysid_ros.extensions.driver.commands.rig_driver",
            "Write a driver for a rig's hardware to begin with.",
        )
    },
)
