"""Simulated experiments on a rig, as bags of the same shape as real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hybrid_sysid_ros.bags import METADATA, joint_states, joint_trajectories, write
from hybrid_sysid_ros.rigs.excitation import Reference, multisine, random_steps, swept_sine
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.files import check_folder

KINDS = ("multisine", "random_steps", "swept_sine")

START = 1_000_000_000
"""Stamp of the first sample [ns]: zero means "no time yet" to ROS."""


def excitation(kind: str, *, seed: int, duration: float) -> Reference:
    """The reference of one kind of experiment [V], much like those of the real records.

    Raises UserError for an unknown kind.
    """
    if kind == "multisine":
        return multisine(seed, amplitude=4.5, low=0.05, high=2.5, lines=40, period=duration)
    if kind == "random_steps":
        return random_steps(seed, amplitude=4.5, hold=1.5, duration=duration)
    if kind == "swept_sine":
        return swept_sine(amplitude=3.0, low=0.05, high=2.0, duration=duration)
    raise UserError(f"experiment {kind!r} is unknown; choose one of {', '.join(KINDS)}")


def simulate(rig: Rig, kind: str, out: Path, *, seed: int, duration: float, rate: float, bias: float = 0.03) -> Path:
    """Drive the simulated rig through an experiment as the real one is driven, by its P controller on the filtered
    position, u = gain (q - yf), and write the bag.

    rate: of the bag's samples [Hz]; each carries the mean input since the one before. Raises UserError for a rate that
    does not divide the rig's, and a place that can't be written.
    """
    every = round(1.0 / (rate * rig.step))
    if every < 1 or abs(every * rig.step * rate - 1.0) > 1e-9:
        raise UserError(f"rate {rate:g} Hz does not divide the rig's {1 / rig.step:g} Hz; choose one that does")
    check_folder(out, marker=METADATA)
    target = excitation(kind, seed=seed, duration=duration)
    plant = Plant(rig, seed=seed, bias=bias)
    samples = round(duration * rate) + 1
    times = np.arange(samples) / rate
    wanted = rig.sensor.radians_per_volt * target(np.arange((samples - 1) * every + 1) * rig.step)
    positions, applied = np.empty((samples, 2)), np.full((samples, 2), np.nan)
    total = 0.0
    for k in range(samples):
        measured = plant.measure()
        positions[k] = measured.position, measured.filtered
        applied[k, 0] = total / every
        total = 0.0
        for step in range(every if k < samples - 1 else 0):
            error = (wanted[k * every + step] - plant.measure().filtered) / rig.sensor.radians_per_volt
            u = float(np.clip(rig.feedback_gain * error, -rig.input_limit, rig.input_limit))
            plant.advance(u)
            total += u
    stamps = START + np.round(times * 1e9).astype(np.int64)
    names = [rig.joint, f"{rig.joint}_filtered"]
    references = wanted[::every][:, None, None]
    return write(
        out,
        [
            joint_states(f"/{rig.name}/joint_states", stamps, names, position=positions, effort=applied),
            joint_trajectories(f"/{rig.name}/reference", stamps, [rig.joint], positions=references, times=[0.0]),
        ],
        replace=True,
        notes={"made_by": f"simulated {rig.name}, {kind}, seed {seed}, {duration:g} s at {rate:g} Hz, bias {bias:g} V"},
    )
