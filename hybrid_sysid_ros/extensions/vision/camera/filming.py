"""Filming: a simulated experiment before a camera: its bag, its true motion, and a film."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.extensions.vision.camera.film import write_film
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager, Picture
from hybrid_sysid_ros.extensions.vision.scene import Scene, scene_of
from hybrid_sysid_ros.rigs.experiments import simulate_experiment
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

BEFORE = 1.0
"""s that a film begins before the experiment, when the lamp goes on."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneMotion:
    """Where a scene's joint was, in the time of an experiment."""

    times: Array
    """(steps,) [s]"""
    angles: Array
    """(steps,) [rad]"""


def experiment(
    rig: Rig, kind: str, bag: Path, *, seed: int, duration: float, rate: float, overwrite: bool = False,
    disturbed: bool = True,
) -> SceneMotion:  # fmt: skip
    """Simulate an experiment into a bag, as :func:`~hybrid_sysid_ros.rigs.experiments.simulate_experiment` does, and
    return the motion of its scene's joint; that of one without a position is its velocity summed up.

    Raises UserError as that does, and where the rig has no scene or none of its states moves the scene's joint.
    """
    scene, seen = scene_of(rig), list[Array]()
    simulate_experiment(
        rig, kind, bag, seed=seed, duration=duration, rate=rate, overwrite=overwrite, disturbed=disturbed,
        watch=lambda plant: seen.append(plant.state.copy()),
    )  # fmt: skip
    return SceneMotion(
        times=np.arange(len(seen), dtype=np.float64) * rig.step, angles=angle_of(rig, scene, np.array(seen))
    )


def angle_of(rig: Rig, scene: Scene, states: Array) -> Array:
    """Angles (steps,) [rad] of a scene's joint by the states (steps, states) at the rig's steps."""
    names, joint = [item.name for item in rig.system.states], rig.joints.joints[scene.joint]
    if joint.position in names:
        return states[:, names.index(joint.position)]
    if joint.velocity not in names:
        raise UserError(f"{rig.file}: scene.joint: no state tells where {scene.joint} is")
    return np.cumsum(states[:, names.index(joint.velocity)]) * rig.step


def film(imager: Imager, motion: SceneMotion, *, before: float = BEFORE) -> Iterator[tuple[float, Picture]]:
    """Times of the film [s] and pictures of a motion, and of the rig at rest ``before`` it [s], the lamp dark."""
    times = np.concatenate([[-before - 1.0, motion.times[0] - 1e-9], motion.times])
    angles = np.concatenate([np.full(2, motion.angles[0]), motion.angles])
    last = motion.times[-1] - imager.lead
    for number in range(int((last + before) * imager.camera.rate) + 1):
        time = number / imager.camera.rate
        yield time, imager.take(time - before, times, angles, onset=0.0)


def filmed(
    rig: Rig, kind: str, bag: Path, video: Path, camera: Camera, *, seed: int, duration: float, rate: float, crf: int,
    overwrite: bool = False,
) -> int:  # fmt: skip
    """Simulate an experiment into a bag and a film; return the number of pictures."""
    motion = experiment(rig, kind, bag, seed=seed, duration=duration, rate=rate, overwrite=overwrite)
    return write_film(video, film(Imager(scene_of(rig), camera, seed=seed), motion), rate=camera.rate, crf=crf)
