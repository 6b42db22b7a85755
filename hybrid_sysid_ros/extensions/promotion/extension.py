"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.promotion"
EXTENSION = Extension(
    name="promotion",
    summary="A better model takes the place of the one in use.",
    commands={"promote": (f"{HERE}.commands.promote", "Put a model into use if it beats the one in use.")},
)
