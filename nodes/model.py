"""Model: what estimator and controller believe about the rig."""

from __future__ import annotations

from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.nodes.base import RigNode
from hybrid_sysid_ros.nodes.source import Source
from hybrid_sysid_ros.runtime.configuration import shipped


def model_of(node: RigNode) -> Model:
    """The model that a node's parameter names, or the one that comes with the package. Raises UserError where it cannot
    be loaded or is of another rig.
    """
    folder = node.settings["model"] or shipped(node.rig.name, "model")
    node.sources["model"] = Source(folder)
    return load(folder, rig=node.rig.source)
