"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.trim"
EXTENSION = Extension(
    name="trim",
    summary="Equilibria of a rig, and the modes about them by name.",
    commands={"trim": (f"{HERE}.commands.trim", "Find an equilibrium of a rig and the modes about it.")},
    provides={"sections": {"modes": f"{HERE}.modes:named_modes"}},
)
