"""URDF and MJCF files of a model's joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.extensions.export.robots.files import TIMESTEP, mjcf, remarks, unsaid_in_urdf, urdf
from hybrid_sysid_ros.extensions.export.robots.joint_dynamics import (
    RUNS,
    JointDynamics,
    joints_of,
    trial_inputs,
    undelayed,
)
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_file, write_text

SUFFIXES = {"urdf": ".urdf", "mjcf": ".xml"}
MOST = 0.25
"""Largest r.m.s. difference of the velocities of a free run in MuJoCo, relative to theirs, with which a file is
written: from there on it would mislead.
"""
SECONDS = 4.0
"""Of the free run [s]."""


@dataclass(frozen=True, kw_only=True)
class RobotExport:
    """What was written. difference: see :data:`MOST`; None without MuJoCo, or for URDF."""

    joints: Sequence[JointDynamics]
    remarks: Sequence[str]
    difference: float | None = None


def export_robot(
    rig: Rig, model: Model, out: Path | str, *, form: str, seal: str, overwrite: bool = False
) -> RobotExport:
    """Write the joints of a model as a file. form: "urdf" or "mjcf".

    Raises UserError where the place can't be written, and for a model whose motion the format can't say.
    """
    check_file(out, suffix=SUFFIXES[form], replace=overwrite)
    joints = joints_of(rig, model)
    notes = remarks(rig, model, joints, seal)
    notes += [line for joint in joints if form == "urdf" for line in unsaid_in_urdf(joint)]
    text = (urdf if form == "urdf" else mjcf)(rig, joints, notes)
    difference = None
    if form == "mjcf" and _mujoco() is not None:
        difference = compared(rig, model, joints, text)
        if difference > MOST:
            raise UserError(
                f"export: a free run in MuJoCo differs by {difference:.0%} from that of the model; it would mislead: "
                f"write an FMU. What MJCF can't say: {' '.join(notes[1:])}"
            )
    write_text(out, text)
    return RobotExport(joints=joints, remarks=notes, difference=difference)


export_urdf, export_mjcf = (partial(export_robot, form=form) for form in SUFFIXES)


def compared(rig: Rig, model: Model, joints: Sequence[JointDynamics], text: str) -> float:
    """R.m.s. difference of the velocities of a free run in MuJoCo, relative to theirs. Its inputs are of the training
    range, and act without delay in both.
    """
    inputs, step = trial_inputs(model, SECONDS, seed=RUNS), model.sampling.step
    names = [item.name for item in model.system.states]
    columns = [names.index(joint.velocity) for joint in joints]
    ours = simulate(undelayed(model), np.zeros(len(names)), inputs, step=step)[1:, columns]
    theirs = _in_mujoco(text, model, joints, inputs)
    return float(np.sqrt(np.mean((ours - theirs) ** 2) / max(float(np.mean(ours**2)), 1e-24)))


def _mujoco() -> Any:
    """The package; None where it is missing."""
    try:
        import mujoco
    except ImportError:
        return None
    return mujoco


def _in_mujoco(text: str, model: Model, joints: Sequence[JointDynamics], inputs: Array) -> Array:
    mujoco = _mujoco()
    made = mujoco.MjModel.from_xml_string(text)
    state = mujoco.MjData(made)
    driven = [item.name for item in model.system.inputs]
    repeats = round(model.sampling.step / TIMESTEP)
    found = []
    for row in inputs:
        for joint in joints:
            if joint.input:
                state.actuator(joint.input).ctrl[0] = row[driven.index(joint.input)]
        for _ in range(repeats):
            mujoco.mj_step(made, state)
        found.append([float(state.joint(joint.name).qvel[0]) for joint in joints])
    return np.array(found)
