"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.frequency_response"
EXTENSION = Extension(
    name="frequency_response",
    summary="Frequency responses of a model with bands, beside those of records.",
    commands={
        "frequency-response": (
            f"{HERE}.commands.frequency_response",
            "Compare a model's frequency response, with its bands, with that of bags.",
        )
    },
)
