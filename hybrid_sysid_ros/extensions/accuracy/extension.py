"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.accuracy"
EXTENSION = Extension(
    name="accuracy",
    summary="The accuracy from simulated and live shots, and the mock-up.",
    commands={
        "accuracy": (f"{HERE}.commands.accuracy", "Tell the accuracy from simulated and live shots."),
        "mockup": (
            f"{HERE}.commands.mockup",
            "From what is known beforehand to a verdict: models, shots, a controller.",
        ),
    },
    provides={"sections": {"mockup": f"{HERE}.setup:Setup.of"}},
)
