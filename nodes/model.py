"""Model: what estimator and controller believe about the rig."""

from __future__ import annotations

from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import shipped


def model_of(rig: Rig, path: str) -> Model:
    """Load a model of a rig; an empty path means the one that comes with the package. Raises UserError where it cannot
    be loaded or is of another rig.
    """
    return load(path or shipped(rig.name, "model"), rig=rig.source)
