"""What this extension adds."""

from pathlib import Path

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.view"
EXTENSION = Extension(
    name="view",
    summary="A running rig on a page of this computer, and its picture for other people's tools.",
    commands={
        "view": (f"{HERE}.commands.view", "Show a running rig on a page of this computer."),
        "rig layouts": (
            f"{HERE}.commands.rig_layouts",
            "Write a rig's URDF, and layouts for Foxglove and PlotJuggler.",
        ),
    },
    nodes={"view": f"{HERE}.nodes.view"},
    declarations=Path(__file__).with_name("nodes.yaml"),
    provides={
        "descriptions": {"urdf": f"{HERE}.drawing:urdf_of"},
        "drawings": {"svg": f"{HERE}.svg_drawing:svg_of"},
        "companions": {"view": f"{HERE}.companion:companion"},
        "sections": {"drawing": f"{HERE}.drawing:Drawing", "faults": f"{HERE}.requests:check_faults"},
    },
)
