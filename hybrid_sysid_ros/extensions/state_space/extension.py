"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="state_space",
    summary="State-space models of any order, from inputs and outputs alone.",
    provides={"structures": {"state_space": "hybrid_sysid_ros.extensions.state_space.structure:StateSpaceStructure"}},
)
