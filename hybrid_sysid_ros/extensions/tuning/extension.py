"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="tuning",
    summary="Weights, horizon and filter noises by closed loops.",
    commands={
        "tune": (
            "hybrid_sysid_ros.extensions.tuning.commands.tune",
            "Tune weights, horizon and filter noises of a rig's loop.",
        ),
    },
)
