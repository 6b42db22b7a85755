"""The loop closed by a camera alone: rendered frames, read, and put in their place when they come late."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.table import Table

from benchmarks.camera.footage import Case, motion_of, shots, steady
from benchmarks.result import spread
from hybrid_sysid_ros.control import ExactMpc
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, simulate_loop
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.estimation import ExtendedKalmanFilter, StateEstimate
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera, Imager
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.footage import LEARNED_FROM
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.extensions.vision.scene import scene_of
from hybrid_sysid_ros.models import load as load_model
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime import configuration
from hybrid_sysid_ros.runtime.configuration import CAMERA, check_tolerances
from hybrid_sysid_ros.support.arrays import Array

PERIOD = 0.005  # s, of estimates and commands
SEEDS = (0, 1, 2)
NOISE = 0.01  # V, of a frame: four times what it has, for what the layers do not explain
ASKED = {"25 ms late": (0.37, 0.09), "50 ms late": (float("nan"), 0.12)}  # V, steps and sine
LEARNED_SEED = 100


@dataclass(frozen=True, kw_only=True)
class PoorReading:
    """When frames come, and which do not."""

    latency: float
    """From the middle of a frame to its use [s]."""
    dropped: float = 0.0
    """Share of the frames."""
    jitter: float = 0.0
    """Of the latency, +- [s]."""
    dark: tuple[float, float] = (0.0, 0.0)
    """From when to when the light is out [s]."""


CASES = {
    "25 ms late": PoorReading(latency=0.025),
    "50 ms late": PoorReading(latency=0.05),
    "25 ms late, 10 % dropped, 10 ms jitter": PoorReading(latency=0.025, dropped=0.1, jitter=0.01),
    "25 ms late, 2 s of darkness": PoorReading(latency=0.025, dark=(10.0, 12.0)),
}


class SeenPlant(Plant):
    """A plant whose sensor is out, and whose motion a camera sees."""

    def __init__(self, rig: Rig, *, seed: int, bias: ArrayLike) -> None:
        super().__init__(rig, seed=seed, bias=bias)
        self.motion = [float(self.state[0])]

    def sensed(self) -> Array:
        return np.full(len(self.rig.sensors), np.nan)

    def advance(self, inputs: ArrayLike) -> None:
        super().advance(inputs)
        self.motion.append(float(self.state[0]))


class Watcher:
    """An estimator that is told what frames show, when they come."""

    def __init__(
        self, estimator: ExtendedKalmanFilter, plant: SeenPlant, layers: PictureLayers, reading: PoorReading, seed: int
    ) -> None:
        self.estimator, self.plant, self.reading = estimator, plant, reading
        self.camera = Camera()
        self.imager = Imager(scene_of(plant.rig), self.camera, seed=seed)
        self.dark = Imager(scene_of(plant.rig), Camera(gain=0.0), seed=seed)
        self.reader = AngleReader(layers)
        self.random = np.random.default_rng(seed)
        self.number = self.seen = self.lost = self.dropped = 0
        self.due = -self.imager.lead  # the first one is of the rig at rest, and known at once

    @property
    def stamp(self) -> float:
        """Of the next frame [s]."""
        return -self.imager.lead + self.number / self.camera.rate

    def update(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """See :class:`~hybrid_sysid_ros.control.closed_loop.Observer`."""
        while self.due <= time + 1e-9:
            self.look()
            self.number += 1
            wanted = self.stamp + self.reading.latency + self.reading.jitter * self.random.uniform(-1, 1)
            self.due = max(wanted, self.stamp + self.imager.lead)
        return self.estimator.update(time, outputs, applied)

    def look(self) -> None:
        """Take the next frame, read it and tell the estimator."""
        if self.number and self.random.uniform() < self.reading.dropped:
            self.dropped += 1
            return
        count = min(len(self.plant.motion), 100)
        last = len(self.plant.motion) - 1
        times = (last - np.arange(count, dtype=np.float64)[::-1]) * self.plant.step
        angles = np.array(self.plant.motion[-count:])
        in_dark = self.reading.dark[0] <= self.stamp < self.reading.dark[1]
        reading = self.reader.read((self.dark if in_dark else self.imager).take(self.stamp, times, angles))
        if not reading.found:
            self.lost += 1
            return
        layers = self.reader.layers
        self.estimator.correct(self.stamp + layers.row_time(reading.row), layers.position(reading.angle), CAMERA)
        self.seen += 1


def learned(rig: Rig) -> PictureLayers:
    """Layers of another film than any that is measured."""
    case = Case(name="", camera=Camera())
    seen = shots(rig, motion_of(rig, seed=LEARNED_SEED), case, seed=LEARNED_SEED)
    return learn(steady(seen.film, LEARNED_FROM), rig, readout=case.camera.readout)[0]


def run(rig: Rig, layers: PictureLayers, reading: PoorReading, seed: int) -> tuple[ClosedLoop, Watcher]:
    """The hardware reference under the shipped policy and its supervisor."""
    model = load_model(configuration.shipped(rig.name, "model"))
    values = {**configuration.defaults(rig.name, "estimator"), "camera_noise": NOISE}
    tuning = configuration.estimator_tuning(values, rig, model.system)
    plant = SeenPlant(rig, seed=seed, bias=rig.bias)
    watcher = Watcher(
        ExtendedKalmanFilter(model.system, tuning, period=PERIOD, latency=0.0), plant, layers, reading, seed
    )
    problem = configuration.mpc_problem(configuration.defaults(rig.name, "controller"), rig, model.system)
    exact = ExactMpc(model.system, problem)
    tolerances = check_tolerances(configuration.defaults(rig.name, "controller"), rig, problem)
    imitation = policy.load(configuration.shipped(rig.name, "policy"), model=model)
    controller = Supervisor(imitation, exact, tolerances)
    controller.reset()
    schedule = rig.schedule()
    scales = np.array([display.scale for display in rig.display])
    loop = simulate_loop(
        plant, watcher, controller, lambda t: scales * schedule(t), inputs=1, duration=schedule.duration,
        period=PERIOD, lead=model.system.delay,
    )  # fmt: skip
    return loop, watcher


def measured(rig: Rig) -> dict[str, Any]:
    """Tracking of the true position by case [as shown], mean and range over seeds, and what became of the frames."""
    layers, schedule = learned(rig), rig.schedule()
    found: dict[str, Any] = {}
    low, high = rig.limits
    for name, reading in CASES.items():
        rows = []
        for seed in SEEDS:
            loop, watcher = run(rig, layers, reading, seed)
            scale = rig.display[0].scale
            row = {key: float(loop.tracking_rmse(*window)[0]) / scale for key, window in schedule.windows.items()}
            beyond = int(((loop.inputs < low - 1e-9) | (loop.inputs > high + 1e-9)).sum())
            rows.append(row | {"beyond": beyond, "lost": watcher.lost, "dropped": watcher.dropped})
        found[name] = {key: spread([row[key] for row in rows]) for key in rows[0]}
        print(f"  {name}: {found[name]}", flush=True)
    return found


def table(found: dict[str, Any]) -> Table:
    """Of all cases."""
    shown = Table(
        "frames", "steps [V]", "sine [V]", "asked", "inputs beyond", "lost", "dropped", title="by camera alone"
    )
    for name, row in found.items():
        cells = [
            f"{row[key]['mean']:.3f} ({row[key]['min']:.3f} to {row[key]['max']:.3f})" for key in ("steps", "sine")
        ]
        counts = [f"{row[key]['max']:.0f}" for key in ("beyond", "lost", "dropped")]
        shown.add_row(name, *cells, " / ".join(f"{value:g}" for value in ASKED.get(name, ())), *counts)
    return shown
