"""Model: what estimator and controller believe about the rig."""

from __future__ import annotations

from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError


def model_of(rig: Rig, path: str) -> Model:
    """Load a model of a rig; an empty path means the one that comes with the package. Raises UserError where it cannot
    be loaded, or is of another rig, or of other inputs or outputs.
    """
    folder = path or str(shipped(rig.name, "model"))
    model = load(folder)
    if model.rig != rig.name:
        raise UserError(f"{folder}: is a model of the rig {model.rig}, not of {rig.name}")
    for kind in ("inputs", "outputs"):
        mine, its = ([item.name for item in getattr(system, kind)] for system in (rig.system, model.system))
        if mine != its:
            raise UserError(f"{folder}: has the {kind} {', '.join(its)}; the rig {rig.name} has {', '.join(mine)}")
    return model
