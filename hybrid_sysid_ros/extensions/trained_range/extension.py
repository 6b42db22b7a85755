"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.trained_range"
EXTENSION = Extension(
    name="trained_range",
    summary="Where a run leaves what its model was trained on.",
    commands={"trained-range": (f"{HERE}.commands.trained_range", "Note what an older model was trained on.")},
    provides={
        "training_notes": {"trained_range": f"{HERE}.trained_range:noted"},
        "loop_checks": {"trained_range": f"{HERE}.live:live_range_of"},
        "report": {"trained_range": f"{HERE}.report.figures:section"},
        "use_checks": {"trained_range": f"{HERE}.use:checked"},
    },
)
