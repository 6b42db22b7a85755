"""What this extension adds."""

from hybrid_sysid_ros.support.extensions import Extension

HERE = "hybrid_sysid_ros.extensions.export"
EXTENSION = Extension(
    name="export",
    summary="Models as CasADi functions; policies as ONNX graphs and as C99; loops as C99.",
    commands={
        "export loop": (f"{HERE}.commands.loop_export", "Write a loop as C99."),
        "model export": (f"{HERE}.commands.model_export", "Write a model as CasADi functions."),
        "policy export": (f"{HERE}.commands.policy_export", "Write a policy as ONNX and as C99."),
    },
    provides={
        "exporters": {
            "loop": f"{HERE}.unit.folder:export_given",
            "model": f"{HERE}.casadi_functions:export_casadi",
            "policy": f"{HERE}.policy_folder:export_loaded",
        }
    },
)
