"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.operating_point.operating_point"
EXTENSION = Extension(
    name="operating_point",
    summary="An MPC about the steady motion at given outputs.",
    provides={"problems": {"operating_point": f"{HERE}:about", "riccati_at": f"{HERE}:ended"}},
)
