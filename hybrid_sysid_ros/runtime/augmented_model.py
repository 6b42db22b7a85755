"""In the loop: what estimators and controllers take a model for, by what its rig's file tells."""

from __future__ import annotations

from dataclasses import replace

from hybrid_sysid_ros.control import Controller
from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.wrappers import RateDisturbanceModel, Stabilised, feedback_of
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig


def believed(rig: Rig, model: Model) -> Model:
    """The model that estimators and controllers have: with the offsets that the rig's file tells of."""
    return replace(model, system=drifting(rig, model.system))


def drifting(rig: Rig, system: System) -> System:
    """A system of the rig with those offsets."""
    if isinstance(system, RateDisturbanceModel) or not rig.offsets:
        return system
    return RateDisturbanceModel(physics=system, on=tuple(rig.offsets))


def controlled(rig: Rig, system: System) -> System:
    """What a controller drives: a system with the rig's offsets, held by the rig's stabiliser where it has one."""
    system = drifting(rig, system)
    if rig.experiments.stabiliser is None:
        return system
    return Stabilised(physics=system, gains=tuple(map(tuple, feedback_of(system, rig.experiments.stabiliser).tolist())))


def driving(rig: Rig, system: System, controller: Controller) -> Controller:
    """A controller of a :func:`controlled` system as one of the rig."""
    return Cascade(controller, system, rig.limits) if isinstance(system, Stabilised) else controller
