"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.horizon_bands"
EXTENSION = Extension(
    name="horizon_bands",
    summary="Bands of predictions some samples ahead, and deviations of a loop's estimates.",
    provides={
        "loop_checks": {"deviations": f"{HERE}.live:live_deviations_of"},
        "training_notes": {"horizon_bands": f"{HERE}.horizon_bands:noted"},
        "inspections": {"horizon_bands": f"{HERE}.inspection:inspection"},
    },
)
