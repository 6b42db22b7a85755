"""What this extension adds."""

from pathlib import Path

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.playback"
EXTENSION = Extension(
    name="playback",
    summary="Bags played again, and recorded loops answered again.",
    commands={
        "play": (f"{HERE}.commands.play", "Publish the messages of a bag again."),
        "replay": (f"{HERE}.commands.replay", "Let estimator and controller answer a recorded loop again."),
    },
    nodes={"player": f"{HERE}.nodes.player"},
    declarations=Path(__file__).with_name("nodes.yaml"),
)
