"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="input_bias",
    summary="Free runs with the input bias of a record's first seconds.",
    provides={"inspections": {"input_bias": "hybrid_sysid_ros.extensions.input_bias.inspection:inspection"}},
)
