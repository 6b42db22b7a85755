"""A rig: its equation, its sensor and its limits, by name."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.rigs.cam_beam import CamBeam
from hybrid_sysid_ros.rigs.sensor import Sensor
from hybrid_sysid_ros.support.configuration_files import configuration_of, load_configuration
from hybrid_sysid_ros.support.errors import UserError

EQUATIONS: dict[str, System] = {"cam_beam": CamBeam()}
"""The best physics known of each rig. The numbers are those identified from its records."""


@dataclass(frozen=True, kw_only=True)
class Rig:
    """joint: its name in messages. step: the plant's integration step [s]. input_limit: drive saturation [+-V].

    feedback_gain: of the P controller that drives the rig's own experiments [V/V].
    """

    name: str
    joint: str
    system: System
    sensor: Sensor
    step: float
    input_limit: float
    feedback_gain: float


def load(name: str) -> Rig:
    """A rig by name, with the numbers of its configuration ``msgs_config/NAME.yaml``.

    Raises UserError for a rig that is not known, or a configuration that lacks a number.
    """
    path = configuration_of(name)
    content = load_configuration(path)
    if name not in EQUATIONS:
        raise UserError(f"{path}: rig {name!r} has no equation; known are {', '.join(EQUATIONS)}")
    try:
        sensor = Sensor(**content["sensor"])
        return Rig(name=name, system=EQUATIONS[name], sensor=sensor, **content["plant"])
    except (KeyError, TypeError) as error:
        raise UserError(f"{path}: sections sensor and plant don't describe the rig ({error})") from error
