"""Friction identified from a camera's positions alone, beside an encoder read at the camera's rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table
from scipy.interpolate import CubicSpline

from benchmarks.camera.footage import Case, Shots, shots, steady
from benchmarks.result import spread
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.friction_atlas.friction_curve import friction_curve
from hybrid_sysid_ros.extensions.vision.camera.filming import experiment
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.footage import LEARNED_FROM
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.identification import evaluate, identify
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

SEEDS = (1, 2, 3)
SECONDS, RATE = 55.0, 200.0
LEARNED, TESTED = ("multisine", "random_steps"), "swept_sine"
SPEEDS = np.linspace(0.02, 1.0, 50)  # rad/s
CASE = Case(name="nominal", camera=Camera())


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """One that was recorded and filmed."""

    record: Record
    seen: Shots

    def between(self, times: Array, positions: Array) -> Record:
        """The record with positions (frames,) at times [s] instead of its own, and splines between them."""
        begin, end = int(np.ceil(times[0] * RATE)), int(np.floor(times[-1] * RATE))
        chosen = slice(begin, end + 1)
        output = np.asarray(CubicSpline(times, positions)(self.record.time[chosen]))[:, None]
        time = self.record.time[: end + 1 - begin]
        return replace(self.record, time=time, input=self.record.input[chosen], output=output, channels={})

    def true(self) -> Record:
        """The record with its true positions."""
        return self.between(self.seen.motion.times, self.seen.motion.angles)


def experiment_with(rig: Rig, kind: str, seed: int) -> Experiment:
    """Simulate an experiment, record it and film it."""
    with TemporaryDirectory() as folder:
        bag = Path(folder) / f"{kind}_{seed}"
        motion = experiment(rig, kind, bag, seed=seed, duration=SECONDS, rate=RATE)
        record = bags.read(bag, rig.signals)
    return Experiment(record=record, seen=shots(rig, motion, CASE, seed=seed))


def zero_of(done: Experiment, reader: AngleReader) -> float:
    """Where the camera sees the joint's zero, by the hold before an experiment [rad]."""
    held = [reader.read(picture).angle for picture in done.seen.at_rest()]
    return float(np.mean(held) - done.seen.motion.angles[0])


def by_camera(done: Experiment, reader: AngleReader, offset: float) -> Record:
    """What the camera says; offset: its zero [rad]."""
    readings = [reader.read(picture) for picture in done.seen.film]
    times = done.seen.times + np.array([reader.layers.row_time(reading.row) for reading in readings])
    return done.between(times, np.array([reading.angle for reading in readings]) - offset)


def by_encoder(done: Experiment) -> Record:
    """What the encoder says when it is read as often as the camera."""
    times = done.record.time
    chosen = np.unique(np.round(done.seen.times * RATE).astype(int))
    return done.between(times[chosen], done.record.output[chosen, 0])


def error_of(model: Model, rig: Rig) -> float:
    """Of the friction curve per volt, relative rms."""
    return friction_curve(model.system, SPEEDS).difference(friction_curve(rig.system, SPEEDS))


def measured(rig: Rig) -> dict[str, Any]:
    """Errors of the curve and free runs on the true angle of an unseen record, by sensor, mean and range over seeds."""
    rows: dict[str, list[dict[str, float]]] = {"camera": [], "encoder": []}
    for seed in SEEDS:
        done = [experiment_with(rig, kind, seed) for kind in LEARNED]
        test = experiment_with(rig, TESTED, seed).true()
        layers, _ = learn(steady(done[0].seen.film, LEARNED_FROM), rig, readout=CASE.camera.readout)
        reader = AngleReader(layers)
        offset = zero_of(done[0], reader)
        reported = {
            "camera": [by_camera(item, reader, offset) for item in done],
            "encoder": [by_encoder(item) for item in done],
        }
        for sensor, records in reported.items():
            model = identify(records, rig, "gray", sampling=Sampling(), seed=seed)
            score = evaluate(model, test)
            rows[sensor].append({"curve": error_of(model, rig), "free_run": score.r2})
            print(f"  seed {seed}, {sensor}: {rows[sensor][-1]}", flush=True)
    return {sensor: {key: spread([row[key] for row in found]) for key in found[0]} for sensor, found in rows.items()}


def table(found: dict[str, Any]) -> Table:
    """Of both sensors."""
    shown = Table("sensor", "error of the friction per volt", "free run on the true angle, R2", title="friction")
    for sensor, row in found.items():
        error, score = row["curve"], row["free_run"]
        shown.add_row(
            sensor,
            f"{100 * error['mean']:.2f} % ({100 * error['min']:.2f} to {100 * error['max']:.2f})",
            f"{score['mean']:.4f} ({score['min']:.4f} to {score['max']:.4f})",
        )
    return shown
