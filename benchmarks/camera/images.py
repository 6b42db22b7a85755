"""Images some seconds ahead, of 160 by 90 pixels: identified motion and learned layers, beside honest baselines."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.camera.black_box import KNOWN, BlackBox
from benchmarks.camera.footage import steady
from benchmarks.camera.friction import CASE, LEARNED, Experiment, by_camera, experiment_with, zero_of
from benchmarks.result import spread
from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.camera_loop import frame_noise
from hybrid_sysid_ros.extensions.vision.prediction.image_prediction import (
    AHEAD,
    PictureModel,
    PredictedFrame,
    SeenMotion,
    judged,
    looks,
)
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.footage import LEARNED_FROM
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers, Plane
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.extensions.vision.reading.likeness import structural_similarity
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.extensions.vision.reading.renderer import LayerRenderer, Renderer
from hybrid_sysid_ros.identification import identify
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

SEEDS = (1, 2, 3)
BIN = 4
"""Pixels of the camera along each side of a pixel here."""
TESTED = {"swept_sine": 0, "random_steps": 100, "multisine": 100}
"""Kinds of records that are predicted, and what is added to the seed, so that none was learned from."""
MORE = 10.0
"""Times the training that the black box is given."""
ASKED = {"likeness": 0.96, "shown_to_error": 1.1, "pictures_per_second": 100.0}  # 2 s ahead
WHOLE = tuple(np.arange(1, 61) / 30.0)
"""s: every picture of two seconds, for the speed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """All that predicts."""

    model: PictureModel
    reader: AngleReader
    """Of the camera's pictures,"""
    small: AngleReader
    """and of binned ones."""
    black_box: BlackBox
    mean: Picture
    seconds: float
    """Of processor time for model and layers."""


class BinnedRenderer(Renderer):
    """Another renderer's pictures, BIN by BIN pixels in one."""

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer

    def take(self, time: float, times: Array, angles: Array) -> Picture:
        return binned(self.renderer.take(time, times, angles))


def binned(picture: Picture) -> Picture:
    """A picture with BIN by BIN pixels in one."""
    rows, columns = picture.shape
    found: Picture = np.round(picture.reshape(rows // BIN, BIN, columns // BIN, BIN).mean(axis=(1, 3))).astype(np.uint8)
    return found


def small(layers: PictureLayers) -> PictureLayers:
    """Layers of binned pictures, by which these are read."""
    sprite = [(0, -size % BIN) for size in layers.alpha.shape]

    def planes(plane: Plane) -> Plane:
        rows, columns = plane.shape
        return plane.reshape(rows // BIN, BIN, columns // BIN, BIN).mean(axis=(1, 3), dtype=np.float32)

    given, off = layers.geometry, (BIN - 1) / 2
    geometry = replace(
        given, pivot_x=(given.pivot_x - off) / BIN, pivot_y=(given.pivot_y - off) / BIN,
        first_u=(given.first_u + off) / BIN, first_v=(given.first_v + off) / BIN, noise=given.noise / BIN,
    )  # fmt: skip
    alpha, texture = (planes(np.pad(plane, sprite)) for plane in (layers.alpha, layers.texture))
    return PictureLayers(geometry=geometry, background=planes(layers.background), alpha=alpha, texture=texture)


def learned(rig: Rig, seed: int) -> Learned:
    """From two experiments and their films, without an encoder; motion and layers as the camera has its pictures, the
    black box as they are predicted.
    """
    done = [experiment_with(rig, kind, seed) for kind in LEARNED]
    began = process_time()
    layers, _ = learn(steady(done[0].seen.film, LEARNED_FROM), rig, readout=CASE.camera.readout)
    reader = AngleReader(layers)
    zero = zero_of(done[0], reader)
    model = identify([by_camera(item, reader, zero) for item in done], rig, "gray", sampling=Sampling(), seed=seed)
    seconds = process_time() - began
    layers = replace(layers, geometry=replace(layers.geometry, zero=zero))
    films = [small_film(item.seen.film) for item in done]
    renderer = BinnedRenderer(LayerRenderer(layers, exposure=CASE.camera.exposure))
    return Learned(
        model=PictureModel(model=model, renderer=renderer),
        reader=AngleReader(layers),
        small=AngleReader(small(layers)),
        black_box=BlackBox(films, [inputs_of(item) for item in done], seconds=MORE * seconds, seed=seed),
        mean=np.round(np.concatenate(films).mean(axis=0)).astype(np.uint8),
        seconds=seconds,
    )


def small_film(film: Film) -> Film:
    """A film of binned pictures."""
    return np.stack([binned(picture) for picture in film])


def inputs_of(done: Experiment) -> Array:
    """Mean inputs (pictures, m) from each picture to the next."""
    times, record = done.seen.times, done.record
    total = np.vstack([np.zeros(record.input.shape[1]), np.cumsum(record.input, axis=0) * record.sampling_time])
    ends = np.append(times, 2.0 * times[-1] - times[-2])
    grid = np.append(record.time, record.time[-1] + record.sampling_time)
    sums = np.stack([np.interp(ends, grid, column) for column in total.T], axis=1)
    return np.asarray(np.diff(sums, axis=0) / np.diff(ends)[:, None])


def watched(done: Experiment, reader: AngleReader) -> tuple[SeenMotion, SeenMotion]:
    """What the camera showed of an experiment, and what is true."""
    layers, readings = reader.layers, [reader.read(picture) for picture in done.seen.film]
    rows = np.array([reading.row for reading in readings])
    positions = np.array([layers.position(reading.angle) for reading in readings])
    seen = SeenMotion(
        times=done.seen.times, seen=done.seen.times + np.array([layers.row_time(row) for row in rows]),
        positions=positions,
    )  # fmt: skip
    return seen, replace(seen, positions=done.seen.truth(rows))


def scored(rig: Rig, found: Learned, kind: str, seed: int) -> tuple[dict[str, dict[str, float]], float]:
    """Means over a record by how far ahead, and pictures a second."""
    done = experiment_with(rig, kind, seed)
    film, motion = small_film(done.seen.film), done.seen.motion
    seen, true = watched(done, found.reader)
    noise, inputs = frame_noise(rig, CASE.camera.width), inputs_of(done)
    began = process_time()
    count = sum(1 for _ in looks(found.model, rig, done.record, seen, noise=noise, ahead=WHOLE))
    speed = count / (process_time() - began)
    rows: dict[float, list[dict[str, float]]] = {seconds: [] for seconds in AHEAD}
    pictures = dict(enumerate(film))
    for look in looks(found.model, rig, done.record, seen, noise=noise):
        row, band = judged(look, pictures, found.mean, found.small, true), found.small.swept
        box = by_black_box(found.black_box, film, inputs, look)
        best = found.model.renderer.take(done.seen.times[look.frame], motion.times, motion.angles)
        reading = found.small.read(box)
        rows[look.ahead].append(
            {
                "likeness": row.likeness,
                "mean_picture": row.mean,
                "newest_picture": row.still,
                "black_box": structural_similarity(box, row.came, band),
                "true_motion": structural_similarity(best, row.came, band),
                "error": row.error,
                "shown": row.shown,
                "black_box_shown": found.reader.layers.position(reading.angle) - float(true.positions[look.frame]),
                "inside": float(abs(row.error) <= 2.0 * look.deviation),
            }
        )
    return {f"{seconds:g} s": _together(each) for seconds, each in rows.items()}, speed


def by_black_box(black_box: BlackBox, film: Film, inputs: Array, look: PredictedFrame) -> Picture:
    """What the black box says that a frame looks like."""
    first = look.newest - KNOWN + 1
    picture: Picture = black_box.predict(film[: look.newest + 1], inputs[first : look.frame + 1])[-1]
    return picture


def _together(rows: list[dict[str, float]]) -> dict[str, float]:
    """Means; of errors [rad] the rms [degrees], and how many the black box shows nowhere."""
    found = {}
    for key in rows[0]:
        values = np.array([row[key] for row in rows])
        known = values[np.isfinite(values)]
        if key in ("error", "shown", "black_box_shown"):
            found[f"{key}_degrees"] = float(np.degrees(np.sqrt(np.mean(known**2)))) if len(known) else float("nan")
        else:
            found[key] = float(values.mean())
        if key == "black_box_shown":
            found["black_box_lost"] = float(1.0 - len(known) / len(values))
    return found


def measured(rig: Rig) -> dict[str, Any]:
    """By record and how far ahead, mean and range over seeds; pictures a second, and what the training took."""
    rows: dict[str, list[dict[str, dict[str, float]]]] = {kind: [] for kind in TESTED}
    speeds, training, boxes = [], [], []
    for seed in SEEDS:
        found = learned(rig, seed)
        training.append(found.seconds)
        boxes.append(found.black_box.seconds)
        for kind, more in TESTED.items():
            row, speed = scored(rig, found, kind, seed + more)
            rows[kind].append(row)
            speeds.append(speed)
            print(f"  seed {seed}, {kind}: {row}, {speed:.0f} pictures/s", flush=True)
    records = {
        kind: {
            seconds: {key: spread([row[seconds][key] for row in each]) for key in each[0][seconds]}
            for seconds in each[0]
        }
        for kind, each in rows.items()
    }
    return {
        "records": records,
        "pictures_per_second": spread(speeds),
        "training_seconds": spread(training),
        "black_box_training_seconds": spread(boxes),
    }


def table(found: dict[str, Any]) -> Table:
    """Of all records."""
    shown = Table(
        "record", "ahead", "likeness", "true motion", "black box", "mean picture", "newest picture", "error [degrees]",
        "as shown", "within 2 deviations", title="images ahead: structural similarity in the band of the sprite",
    )  # fmt: skip
    for kind, rows in found["records"].items():
        for seconds, row in rows.items():
            likeness = row["likeness"]
            cells = [f"{likeness['mean']:.3f} ({likeness['min']:.3f} to {likeness['max']:.3f})"]
            cells += [f"{row[key]['mean']:.3f}" for key in ("true_motion", "black_box", "mean_picture")]
            cells += [f"{row[key]['mean']:.3f}" for key in ("newest_picture", "error_degrees", "shown_degrees")]
            shown.add_row(kind, seconds, *cells, f"{row['inside']['mean']:.0%}")
    speed = found["pictures_per_second"]
    shown.caption = f"{speed['mean']:.0f} pictures/s (asked {ASKED['pictures_per_second']:g})"
    return shown
