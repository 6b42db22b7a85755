"""Model: what estimator and controller believe about the rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.nodes.source import Source
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import estimator_model, shipped


def model_of(rig: Rig, settings: Mapping[str, Any]) -> tuple[Model, Source]:
    """The model that the parameter names, or the one that comes with the package, and where it was read. Raises
    UserError where it cannot be loaded or is of another rig.
    """
    folder = settings["model"] or shipped(rig.name, "model")
    source = Source(folder)
    return estimator_model(rig, load(folder, rig=rig.source)), source
