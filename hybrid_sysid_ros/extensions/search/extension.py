"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="search",
    summary="The search for the options of a structure.",
    commands={
        "search": ("hybrid_sysid_ros.extensions.search.commands.search", "Search the options of a structure."),
    },
)
