"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.narx"
EXTENSION = Extension(
    name="narx",
    summary="Polynomial NARX models, and parallel models of the residual of a gray box.",
    provides={
        "structures": {
            "narx": f"{HERE}.narx_structure:NarxStructure",
            "residual": f"{HERE}.residual_structure:ResidualStructure",
        }
    },
)
