"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="tightening",
    summary="Bounds of the MPC that are moved in by the band of its prediction.",
    provides={"problems": {"tightening": "hybrid_sysid_ros.extensions.tightening.tightening:declared"}},
)
