"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.loop_bands"
EXTENSION = Extension(
    name="loop_bands",
    summary="Bands of closed loops that are forecast from their commands.",
    provides={
        "training_notes": {"loop_bands": f"{HERE}.loop_bands:noted"},
        "inspections": {"loop_bands": f"{HERE}.inspection:inspection"},
    },
)
