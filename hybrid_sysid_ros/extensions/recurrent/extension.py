"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="recurrent",
    summary="A gated recurrent network as a model structure.",
    provides={"structures": {"recurrent": "hybrid_sysid_ros.extensions.recurrent.structure:RecurrentStructure"}},
)
