"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="ipopt",
    summary="IPOPT as the slow reference of the exact MPC.",
    provides={"solvers": {"ipopt": "hybrid_sysid_ros.extensions.ipopt.interior_point:InteriorPointMpc"}},
)
