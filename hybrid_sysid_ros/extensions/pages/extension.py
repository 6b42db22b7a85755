"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="pages",
    summary="The documentation, read where it was installed.",
    commands={"docs": ("hybrid_sysid_ros.extensions.pages.commands.docs", "Read the documentation in the terminal.")},
)
