"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.experiment_design"
EXTENSION = Extension(
    name="experiment_design",
    summary="The next experiment, by what a model does not know yet.",
    provides={"record_remarks": {"experiment_design": f"{HERE}.remarks:remarks_of"}},
    commands={"design": (f"{HERE}.commands.design", "Design the next experiment, and say what one has shown.")},
)
