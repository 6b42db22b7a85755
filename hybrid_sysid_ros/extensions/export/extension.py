"""What this extension adds."""

from pathlib import Path

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.export"
EXTENSION = Extension(
    name="export",
    summary="Models as CasADi functions and FMUs; policies as ONNX graphs and as C99; loops as C99 and FMUs.",
    commands={
        "export fmu": (f"{HERE}.commands.fmu_export", "Write a model, a plant or a controller as an FMU."),
        "export board": (f"{HERE}.commands.board_export", "Write a loop for a microcontroller."),
        "export mjcf": (f"{HERE}.commands.mjcf_export", "Write a MuJoCo model with identified joints."),
        "export page": (f"{HERE}.commands.page_export", "Write a page on which the rig and its controller run."),
        "export ros2_control": (f"{HERE}.commands.ros2_control_export", "Write a colcon package with a controller."),
        "export urdf": (f"{HERE}.commands.urdf_export", "Write a URDF with identified joints."),
        "export loop": (f"{HERE}.commands.loop_export", "Write a loop as C99."),
        "model export": (f"{HERE}.commands.model_export", "Write a model as CasADi functions."),
        "policy export": (f"{HERE}.commands.policy_export", "Write a policy as ONNX and as C99."),
    },
    declarations=Path(__file__).with_name("nodes.yaml"),
    provides={
        "companions": {"board": f"{HERE}.board.companion:companion"},
        "controllers": {"board": f"{HERE}.board.driving:controller"},
        "demos": {"board": f"{HERE}.commands.board_demo:instead"},
        "exporters": {
            "fmu": f"{HERE}.fmu.export:export_fmu",
            "mjcf": f"{HERE}.robots.export:export_mjcf",
            "page": f"{HERE}.page.export:export_page",
            "ros2_control": f"{HERE}.ros2_control.export:export_ros2_control",
            "urdf": f"{HERE}.robots.export:export_urdf",
            "loop": f"{HERE}.unit.folder:export_loop",
            "model": f"{HERE}.casadi_functions:export_casadi",
            "policy": f"{HERE}.policy_folder:export_loaded",
        },
    },
)
