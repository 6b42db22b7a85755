"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="friction_atlas",
    summary="The laws of friction by name, drawn in four experiments.",
    commands={
        "friction": (
            "hybrid_sysid_ros.extensions.friction_atlas.commands.friction",
            "Draw a law of friction, or list them.",
        )
    },
    provides={"comparisons": {"friction": "hybrid_sysid_ros.extensions.friction_atlas.comparison:comparison"}},
)
