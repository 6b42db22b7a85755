"""What this extension adds."""

from pathlib import Path

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.commander"
EXTENSION = Extension(
    name="commander",
    summary="Commands in plain language, and a server of them for language models.",
    commands={
        "say": (f"{HERE}.commands.say", "Say in plain language what the rig is to do."),
        "mcp": (f"{HERE}.commands.mcp", "Serve checked commands to language models."),
    },
    nodes={"commander": f"{HERE}.nodes.commander"},
    declarations=Path(__file__).with_name("nodes.yaml"),
    provides={
        "companions": {"commander": f"{HERE}.companion:companion"},
        "sections": {"names": f"{HERE}.language.vocabulary:spoken_names"},
    },
)
