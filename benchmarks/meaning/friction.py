"""Friction: identified from films of four rigs, beside what the rigs' own sensors say; goes on as films do."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.meaning import films
from benchmarks.meaning.rows import Row
from benchmarks.meaning.second_renderer import FilmCase, SecondRenderer, write
from benchmarks.resumed import digest, resumed
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.bags.signals import Signals
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.friction_atlas.friction_curve import friction_curve
from hybrid_sysid_ros.extensions.vision.camera.filming import experiment
from hybrid_sysid_ros.extensions.vision.reading import video_record
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import Rig, load
from hybrid_sysid_ros.support.arrays import Array

PART = Path("out/meaning_friction.json")
CODE = (
    *films.READING, "benchmarks/meaning/films.py", "benchmarks/meaning/friction.py",
    "benchmarks/meaning/second_renderer.py",
    *(f"hybrid_sysid_ros/{room}" for room in ("bags", "core", "models", "identification", "rigs", "structures")),
)  # fmt: skip
"""What sets the answers."""
SECONDS, RATE, ASKED = 20.0, 30.0, 0.03
STARTS = 10  # of each fit: a rig that sticks has several ends
RATES: Mapping[str, float] = {"wheel_motor": 60.0, "drill_string": 60.0}
"""Pictures a second of rigs that turn far between two of them."""
FILMED: Mapping[str, tuple[str, ...]] = {
    "cam_beam": ("multisine", "random_steps"),
    "flexible_joint": ("multisine", "random_steps"),
    "wheel_motor": ("multisine", "random_steps"),
    "drill_string": ("random_steps", "multisine"),
}
STRIBECK: Mapping[str, tuple[str, ...]] = {
    "flexible_joint": ("coulomb", "static_excess", "stribeck_speed", "viscous_friction"),
    "drill_string": ("coulomb", "static_excess", "stribeck_speed", "bit_damping"),
}
"""Parameters of the curves of rigs with several velocities."""


def records(rig: Rig, kind: str, seed: int) -> tuple[Record, Record]:
    """By the rig's own sensors, and with the film in the place of the joint's."""
    scene = scene_of(rig)
    pivot = (float(scene.pivot[0]), float(scene.pivot[1]))
    case = FilmCase(
        name=f"{rig.name}, {kind}", rig=rig.name, kind=kind, seconds=SECONDS, rate=RATES.get(rig.name, RATE),
        width=480, height=270, exposure=0.004, readout=0.008, pivot=pivot, seed=seed,
    )  # fmt: skip
    with TemporaryDirectory() as place:
        folder = Path(place)
        motion = experiment(rig, kind, folder / "bag", seed=seed, duration=SECONDS, rate=200.0, disturbed=False)
        reach = max(patch.reach for patch in scene.sprite)
        write(folder / "film.mp4", SecondRenderer(case, motion.times, motion.angles, reach))
        record = films.read(folder / "film.mp4", rig, folder / "bag", case)
        seen = video_record.at_rate(record, video_record.usual_rate(record))
        video_record.write(
            seen, rig, scene.joint, folder / "bag", folder / "seen", replace=False, made_by="benchmarks.meaning"
        )
        video_record.write_signals(folder / "signals.yaml", rig, scene.joint)
        signals = Signals.load(folder / "signals.yaml").ordered(rig.system.inputs, rig.system.outputs)
        return bags.read(folder / "bag", rig.signals), bags.read(folder / "seen", signals)


def friction(rig: str, system: System, speeds: Array) -> Array:
    """Over speeds (speeds,): as an input, where the rig has one velocity, and otherwise as the torque of its Stribeck
    curve, c + s exp(-(v / w)^2) + d v.
    """
    if rig not in STRIBECK:
        return friction_curve(system, speeds).inputs
    level, excess, width, viscous = (system.named[name] for name in STRIBECK[rig])
    return np.asarray(level + excess * np.exp(-((speeds / width) ** 2)) + viscous * speeds)


def difference(name: str) -> dict[str, float]:
    """Relative rms difference of the friction by film from that by the rig's sensors."""
    rig = load(name)
    pairs = [records(rig, kind, seed) for seed, kind in enumerate(FILMED[name])]
    options = {"starts": STARTS}
    own, seen = (
        identify([pair[k] for pair in pairs], rig, "gray", sampling=Sampling(), options=options, seed=0) for k in (0, 1)
    )
    rubs = next(iter(rig.system.contacts)).on
    low, high = own.training_range[rubs]
    speeds = max(-low, high) * np.linspace(0.05, 1.0, 40)
    ratio = friction(name, seen.system, speeds) / friction(name, own.system, speeds)
    return {"difference": float(np.sqrt(np.mean((ratio - 1.0) ** 2)))}


def measured() -> tuple[Mapping[str, Any], list[Row]]:
    """All four rigs, as far as they are read; one that is not falls short."""
    code = digest(*CODE)
    done = resumed(PART, (("friction", name, partial(difference, name)) for name in FILMED), code)["friction"]
    found = {name: item["difference"] for name, item in done.items()}
    rows = [
        Row(
            name=f"friction by film beside the sensors', {name}", asked=ASKED, measured=found.get(name, np.nan),
            at_most=True,
        )
        for name in FILMED
    ]  # fmt: skip
    return {
        "code": code,
        "seconds": SECONDS,
        "pictures_per_second": {name: RATES.get(name, RATE) for name in FILMED},
        "difference": found,
    }, rows
