"""Joint reference: what a bag says of a joint's motion, by which a film is put in the bag's time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.bags.bag import opened
from hybrid_sysid_ros.bags.columns import MissingInMessageError, TopicColumns
from hybrid_sysid_ros.core.rollout import simulate
from hybrid_sysid_ros.rigs.joints import MEASUREMENTS
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

FEWEST = 10  # messages


class MotionSource(Enum):
    """By what a film is synchronised."""

    POSITION = "position"
    SPEED = "speed"
    INPUT = "input"
    """The speed that the rig's own equations have under the recorded inputs, from rest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointReference:
    """A joint's motion in a bag."""

    kind: MotionSource
    origin: int
    """First stamp [ns]."""
    times: Array
    """From there on (samples,) [s]."""
    values: Array
    """Positions [rad], or speeds [rad/s]."""


def column(rig: Rig, bag: Path, field: str, topic: str = MEASUREMENTS) -> tuple[NDArray[np.int64], Array]:
    """Stamps [ns] and values of a field of one of a rig's topics in a bag, without those that are no numbers.

    Raises UserError where the bag has no such topic, MissingInMessageError where its messages have no number there.
    """
    name = f"/{rig.namespace}/{topic}"
    stamps, values = list[NDArray[np.int64]](), list[Array]()
    with opened(bag) as found:
        if name not in found.topics:
            raise UserError(f"{bag}: no topic {name}: the bag has {found.listing}")
        for block in found.blocks({name}):
            columns = TopicColumns(block)
            values.append(columns.values(field))
            stamps.append(columns.stamps(field))
    known = np.isfinite(np.concatenate(values))
    if not known.any():
        raise MissingInMessageError(f"all messages of {name}")
    when, where = np.concatenate(stamps)[known], np.concatenate(values)[known]
    if len(when) < FEWEST or not (np.diff(when) > 0).all():
        raise UserError(f"{bag}: {name} has no {field} at times that rise: nothing to synchronise with")
    return when, where


def joint_reference(rig: Rig, joint: str, bag: Path) -> JointReference:
    """The motion of a joint: its position where the bag has it, or else its speed, at the times that its sensor's delay
    and window tell of, or else what the inputs do to it.

    Raises UserError where the bag has none of these.
    """
    for kind, field in ((MotionSource.POSITION, "position"), (MotionSource.SPEED, "velocity")):
        try:
            when, values = column(rig, bag, f"{field}[{joint}]")
        except MissingInMessageError:
            continue
        times = (when - when[0]) * 1e-9 - _late(rig, joint, field)
        return JointReference(kind=kind, origin=int(when[0]), times=times, values=values)
    return _by_input(rig, joint, bag)


def _late(rig: Rig, joint: str, field: str) -> float:
    """How long before its stamp a joint's position or speed was what its sensor read [s], by the rig's file."""
    for variable, sensor in zip(rig.system.outputs, rig.sensors, strict=True):
        if rig.joints.place(variable.name) == (joint, field):
            return sensor.delay + 0.5 * sensor.window
    return 0.0


def _by_input(rig: Rig, joint: str, bag: Path) -> JointReference:
    """The speed of a joint under the bag's inputs, from rest."""
    names, moved = [item.name for item in rig.system.states], rig.joints.joints[joint]
    inputs = []
    for variable in rig.system.inputs:
        place, field = rig.joints.place(variable.name)
        try:
            inputs.append(column(rig, bag, f"{field}[{place}]"))
        except MissingInMessageError as error:
            raise UserError(
                f"{bag}: it has neither position nor speed of {joint}, and {error} lacks the input {variable.name}: a "
                "film is put in a bag's time by one of these; leave out --bag"
            ) from error
    origin = max(int(when[0]) for when, _ in inputs)
    last = min(int(when[-1]) for when, _ in inputs)
    times: Array = np.arange(0.0, (last - origin) * 1e-9, rig.step, dtype=np.float64)
    held = [values[np.searchsorted((when - origin) * 1e-9, times).clip(max=len(when) - 1)] for when, values in inputs]
    states = simulate(rig.system, np.zeros(len(names)), np.column_stack(held), step=rig.step)[: len(times)]
    values: Array
    if moved.velocity in names:
        values = states[:, names.index(moved.velocity)]
    elif moved.position in names:
        values = np.gradient(states[:, names.index(moved.position)], rig.step).astype(np.float64)
    else:
        raise UserError(f"{bag}: it has neither position nor speed of {joint}, and no state of {rig.name} is either")
    if not np.isfinite(values).all():
        raise UserError(f"{bag}: under its inputs the equations of {rig.name} end in no number: leave out --bag")
    return JointReference(kind=MotionSource.INPUT, origin=origin, times=times, values=values)
