"""What this extension adds."""

from hybrid_sysid_ros.support.manifest import Extension

EXTENSION = Extension(
    name="resimulation",
    summary="The closed loop of a record, done again on a model from its commands.",
    provides={"loops": {"commands": "hybrid_sysid_ros.extensions.resimulation.loop_again:scores_again"}},
)
