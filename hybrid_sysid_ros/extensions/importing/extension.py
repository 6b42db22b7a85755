"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.importing"
EXTENSION = Extension(
    name="importing",
    summary="Records of other worlds become bags of a rig.",
    commands={
        "import": (f"{HERE}.commands.import_files", "Turn records of other programs into bags of a rig."),
        "rig from": (f"{HERE}.commands.rig_from", "Write a rig for identification out of a record."),
    },
)
