"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="demo",
    summary="From bags to a controlled rig, in one command.",
    commands={
        "demo": (
            "hybrid_sysid_ros.extensions.demo.commands.demo",
            "From bags to a controlled rig: identify, run the loop, report.",
        )
    },
    provides={"sections": {"demo": "hybrid_sysid_ros.extensions.shared.demo_recipe:checked"}},
)
