"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.native"
EXTENSION = Extension(
    name="native",
    summary="The loop as one process in C: estimator and controller on ROS 2 without Python.",
    provides={
        "companions": {"native": f"{HERE}.companion:companion"},
        "demos": {"native": f"{HERE}.commands.native_demo:instead"},
    },
)
