"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="ensemble",
    summary="Several models of one rig together: their mean, and how far they spread.",
    commands={
        "ensemble": (
            "hybrid_sysid_ros.extensions.ensemble.commands.ensemble",
            "Score several models together on bags.",
        )
    },
)
