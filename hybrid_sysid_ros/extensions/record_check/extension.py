"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

HERE = "hybrid_sysid_ros.extensions.record_check"
EXTENSION = Extension(
    name="record_check",
    summary="A record against itself and its rig, before a fit.",
    commands={"check-record": (f"{HERE}.commands.check_record", "Check records before a model is fitted to them.")},
    provides={
        "record_checks": {"record_check": f"{HERE}.check:findings_of"},
        "use_checks": {"guessed_law": f"{HERE}.guessed_law:checked"},
    },
)
