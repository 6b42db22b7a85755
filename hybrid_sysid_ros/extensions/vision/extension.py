"""What this extension adds."""

from pathlib import Path

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.vision"
EXTENSION = Extension(
    name="vision",
    summary="A camera: films, positions out of pictures, a loop that it closes, and pictures as goals.",
    commands={
        "film": (f"{HERE}.commands.film", "Simulate an experiment before a camera: its bag and a film."),
        "video": (f"{HERE}.commands.video", "Read a joint's angle out of a film and write a bag."),
    },
    nodes={"camera": f"{HERE}.nodes.camera", "vision": f"{HERE}.nodes.vision"},
    declarations=Path(__file__).with_name("nodes.yaml"),
    provides={
        "companions": {"vision": f"{HERE}.companion:companion"},
        "controllers": {"picture": f"{HERE}.goal.goal_picture:controller"},
        "demos": {"camera": f"{HERE}.commands.camera_demo:instead"},
        "pictures": {"reader": f"{HERE}.goal.goal_picture:PictureReader.of"},
        "sections": {"scene": f"{HERE}.scene:scene_of"},
    },
)
