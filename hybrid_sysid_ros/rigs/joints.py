"""Joints: states, outputs and inputs of a rig in joint messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hybrid_sysid_ros.bags.signals import Given, Signal
from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.rigs.sensor import Sensor
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import built

MEASUREMENTS, COMMANDS, REFERENCES = "joint_states", "joint_command", "reference"
"""Topics of outputs and applied inputs, of commanded inputs, and of references."""
FILTERED = "filtered"
"""Suffix of the name of a joint's second entry, with its low-pass filtered outputs."""


@dataclass(frozen=True, kw_only=True)
class Joint:
    """The variables of a joint's entry: a state or output as position and velocity, an input as effort."""

    position: str = ""
    velocity: str = ""
    effort: str = ""

    def field_of(self, name: str) -> str:
        """The field of a state, output or input; "" for none."""
        return next((key for key in ("position", "velocity", "effort") if getattr(self, key) == name), "")


@dataclass(frozen=True, kw_only=True)
class Joints:
    """The joints of a rig by name, in their order in messages."""

    joints: Mapping[str, Joint]

    @classmethod
    def of(cls, content: Mapping[str, Any], system: System, where: str) -> Joints:
        """Joints from a section of rig.yaml. An output or input without a joint gets one with its name.

        Raises UserError where a joint names a variable that the system lacks, or two joints carry the same one.
        """
        joints = {name: built(Joint, value, f"{where}.{name}") for name, value in content.items()}
        inputs = [item.name for item in system.inputs]
        outputs = [item.name for item in system.outputs]
        moving = list(dict.fromkeys([*(item.name for item in system.states), *outputs]))
        carried: list[str] = []
        for name, joint in joints.items():
            for key in ("position", "velocity", "effort"):
                value, known = getattr(joint, key), inputs if key == "effort" else moving
                if value and value not in known:
                    raise UserError(f"{where}.{name}.{key}: {value!r} is none of {', '.join(known)}")
                if value and value in carried:
                    raise UserError(f"{where}.{name}.{key}: {value} is carried by another joint already")
                carried += [value] if value else []
        for name in (*outputs, *inputs):
            if name not in carried:
                joint = Joint(effort=name) if name in inputs else Joint(position=name)
                if name in joints:
                    raise UserError(f"{where}.{name}: carries no {name}, as its name says; add it or rename the joint")
                joints[name] = joint
        return cls(joints=joints)

    @property
    def names(self) -> list[str]:
        return list(self.joints)

    def place(self, name: str) -> tuple[str, str]:
        """Joint and field of an output or an input."""
        found = ((joint, item.field_of(name)) for joint, item in self.joints.items())
        return next(place for place in found if place[1])

    def filtered(self, outputs: Sequence[str], sensors: Sequence[Sensor]) -> dict[str, str]:
        """Joints with a low-pass filtered output, and the names of the entries of these outputs."""
        low_passed = [name for name, sensor in zip(outputs, sensors, strict=True) if sensor.low_pass]
        places = dict.fromkeys(self.place(name)[0] for name in low_passed)
        return {joint: f"{joint}_{FILTERED}" for joint in places}

    def signals(self, system: System, sensors: Sequence[Sensor]) -> Given:
        """Signals of inputs, outputs and channels in these topics; see :meth:`.Rig.channel`."""

        def signals(
            variables: Sequence[Variable], topic: str, form: str = "{field}[{joint}]", holds: str = "preceding"
        ) -> dict[str, Signal]:
            found = {}
            for item in variables:
                joint, field = self.place(item.name)
                selector = form.format(
                    joint=joint, field=field, fields="positions" if field == "position" else "velocities"
                )
                found[item.name] = Signal(topic=topic, field=selector, unit=item.unit, holds=holds)
            return found

        def channels(kind: str, of: Sequence[Variable], found: dict[str, Signal]) -> dict[str, Signal]:
            return {kind if len(of) == 1 else f"{kind}_{name}": signal for name, signal in found.items()}

        inputs, outputs = system.inputs, system.outputs
        low_passed = [item for item, sensor in zip(outputs, sensors, strict=True) if sensor.low_pass]
        filtered = signals(low_passed, MEASUREMENTS, "{field}[{joint}_filtered]")
        references = signals(outputs, REFERENCES, "points[0].{fields}[{joint}]")
        commands = signals(inputs, COMMANDS, holds="following")
        further = {
            **channels(FILTERED, outputs, filtered),
            **channels("reference", outputs, references),
            **channels("command", inputs, commands),
        }
        return signals(inputs, MEASUREMENTS), signals(outputs, MEASUREMENTS), further
