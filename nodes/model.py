"""Model: what estimator and controller believe about the rig."""

from __future__ import annotations

from hybrid_sysid_ros.models import Model, load
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import shipped
from hybrid_sysid_ros.support.errors import UserError


def model_of(rig: Rig, path: str) -> Model:
    """Load a model of a rig; an empty path means the one that comes with the package.

    Raises:
        UserError: it cannot be loaded, is of another rig, or has not the one joint that the messages carry.
    """
    folder = path or str(shipped(rig.name, "model"))
    model = load(folder)
    if model.rig != rig.name:
        raise UserError(f"{folder}: is a model of the rig {model.rig}, not of {rig.name}")
    states = len(model.system.states)
    if states != 2 or dict(model.system.kinematics) != {0: 1}:
        raise UserError(f"{folder}: has {states} states; the nodes carry the position and velocity of one joint")
    return model
